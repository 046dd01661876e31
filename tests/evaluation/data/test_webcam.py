"""Webcam sequences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import between, photograph

from elf_eval.data import open_dataset


@pytest.mark.parametrize("inner", ["", "test/image_color"])
def test_webcam_is_the_identity_in_natural_order(tmp_path, inner):
    folder = tmp_path / "Chamonix" / inner
    folder.mkdir(parents=True)
    for n in (1, 2, 10):
        cv2.imwrite(str(folder / f"{n}.png"), photograph(n))
    pairs = open_dataset(f"webcam:{tmp_path}").pairs
    assert [p.second.path.name for p in pairs] == ["2.png", "10.png"]
    point = np.array([[30.0, 40.0]])
    assert between(pairs[0]).forward(point) == pytest.approx(point)
    assert len(open_dataset(f"webcam:{tmp_path}?limit=2").pairs) == 1
