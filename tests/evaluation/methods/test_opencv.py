"""OpenCV's detectors and descriptors."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import check

from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import open_method
from elf_eval.methods.opencv import OPENCV, installed


@pytest.mark.parametrize("kind", [k for k in OPENCV if k not in ("aliked", "disk")])
def test_opencv(kind, image):
    if not installed(kind):
        with pytest.raises(EvalError, match=f"{kind}: this OpenCV build .* has no"):
            open_method(kind)
        return
    found = open_method(kind).extract(image, 30)
    check(found)
    assert len(found) <= 30
    # MSER finds nothing stable in a picture of flat shapes.
    assert len(found) > 0 or kind == "mser"


def test_opencv_takes_its_own_arguments_and_refuses_others(image):
    few = open_method("sift?contrastThreshold=0.15").extract(image, 500)
    assert len(few) < len(open_method("sift").extract(image, 500))
    with pytest.raises(EvalError, match="nonsense"):
        open_method("sift?nonsense=3")


@pytest.mark.parametrize("kind", ["sift", "orb"])
def test_a_flat_image_has_no_keypoints_but_descriptors_of_the_right_kind(kind, tmp_path):
    cv2.imwrite(str(tmp_path / "flat.png"), np.full((100, 100, 3), 90, np.uint8))
    flat = ImageRef("flat", tmp_path / "flat.png").open(None)
    found = open_method(kind).extract(flat, 10)
    assert len(found) == 0
    assert found.descriptors.shape[1] > 0
    assert (found.descriptors.dtype == np.uint8) == (kind == "orb")
