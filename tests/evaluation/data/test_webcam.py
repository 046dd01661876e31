"""Webcam sequences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import between, photograph

from elf_eval.data import open_dataset
from elf_eval.errors import EvalError


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


def test_a_limit_that_leaves_no_pair_is_refused(tmp_path):
    for n in (1, 2, 3):
        cv2.imwrite(str(tmp_path / f"{n}.png"), photograph(n))
    for limit in (1, 0, -1):
        with pytest.raises(EvalError, match=f"option limit={limit}: a scene's pairs need two images$"):
            open_dataset(f"webcam:{tmp_path}?limit={limit}")
