"""OpenCV's detectors and descriptors."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scenes import check

from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import open_method
from elf_eval.methods.opencv import OPENCV, installed


@pytest.mark.parametrize("kind", [k for k in OPENCV if not k.startswith("cv2-")])
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


class Params:
    """As OpenCV's ALIKED has them."""

    def __init__(self):
        self.inputSize = (640, 640)


class Network:
    """As OpenCV's networks: what they were made with, and a keypoint where the image is red."""

    def __init__(self, *given, **named):
        self.given, self.named = given, named

    def detectAndCompute(self, pixels, mask):  # noqa: N802
        y, x = np.argwhere(pixels[..., 2] > 200)[0]
        return [cv2.KeyPoint(float(x), float(y), 1.0, -1.0, 0.5)], np.eye(1, 128, dtype=np.float32)


@pytest.fixture
def networks(monkeypatch, tmp_path):
    """An OpenCV that has both, whichever version is installed; and a model file."""
    for name in ("ALIKED", "DISK"):
        monkeypatch.setattr(cv2, name, SimpleNamespace(Params=Params), raising=False)
        monkeypatch.setattr(cv2, f"{name}_create", Network, raising=False)
    (tmp_path / "m.onnx").write_bytes(b"model")
    return str(tmp_path / "m.onnx")


def test_networks_have_their_file_and_their_arguments(networks):
    made = open_method(f"cv2-aliked:{networks}?inputSize=640,480")._make(40)
    assert made.given == (networks,)
    assert made.named["params"].inputSize == (640, 480)
    made = open_method(f"cv2-disk:{networks}?imageSize=640,480&scoreThreshold=0.5")._make(40)
    assert (made.given, made.named) == (
        (networks,),
        {"maxKeypoints": 40, "imageSize": (640, 480), "scoreThreshold": 0.5},
    )
    with pytest.raises(EvalError, match=r"cv2-aliked: OpenCV does not take .*: radius is none of \['inputSize'\]"):
        open_method(f"cv2-aliked:{networks}?radius=3")


def test_networks_get_the_colours(networks, tmp_path):
    pixels = np.zeros((60, 80, 3), np.uint8)
    pixels[20, 31] = (0, 0, 255)
    cv2.imwrite(str(tmp_path / "dot.png"), pixels)
    found = open_method(f"cv2-aliked:{networks}").extract(ImageRef("dot.png", tmp_path / "dot.png").open(None), 5)
    assert (found.keypoints.tolist(), found.scores.tolist()) == ([[31.0, 20.0]], [0.5])


@pytest.mark.parametrize(("kind", "name"), [("cv2-aliked", "ALIKED"), ("cv2-disk", "DISK")])
def test_an_opencv_without_them_says_so(kind, name, networks, monkeypatch):
    monkeypatch.delattr(cv2, f"{name}_create")
    assert not installed(kind)
    with pytest.raises(EvalError, match=rf"{kind}: this OpenCV build \(.*\) has no {name}; OpenCV 5 has"):
        open_method(f"{kind}:{networks}")
