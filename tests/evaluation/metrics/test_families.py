"""Names of metrics."""

from __future__ import annotations

import numpy as np

from elf_eval.data.images import ImageRef
from elf_eval.data.truth import Calibrated, Homography
from elf_eval.methods import open_method
from elf_eval.metrics.families import ERRORS, metric_names
from elf_eval.metrics.pair import pair_metrics
from elf_eval.protocol import Protocol
from elf_eval.run.cache import extract


def test_metric_names_are_those_of_a_pair(photo_file, tmp_path):
    found = extract(open_method("orb"), ImageRef("photo.png", photo_file), Protocol(size=None))
    np.save(tmp_path / "depth.npy", np.full((160, 200), 5.0, np.float32))
    camera, depth = (100.0, 0.0, 99.5, 0.0, 100.0, 79.5, 0.0, 0.0, 1.0), tmp_path / "depth.npy"
    pose = Calibrated(camera, camera, tuple((np.eye(4) + 0.1 * np.eye(4, k=3)).ravel()))
    for truth in (Homography(), pose, Calibrated(camera, camera, pose.transform, depth, depth)):
        record = pair_metrics(found, found, truth, Protocol(size=None))
        assert metric_names(truth) == [name for name in record if name not in ERRORS]
