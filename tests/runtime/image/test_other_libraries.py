"""Images of other libraries than OpenCV: RGB arrays, PIL's images, and what becomes an array."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import ElfFeature2D, ElfRuntime, ImageError, SettingError
from elf_runtime.image import read
from helpers import ROOT, TINY

PALACE = np.asarray(cv2.imread(str(ROOT / "demo" / "palace.jpg")), np.uint8)
RGB = np.ascontiguousarray(PALACE[:, :, ::-1])


class Tensor:
    """As other libraries' arrays are, to numpy."""

    def __init__(self, values: Any) -> None:
        self.values = values

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        if isinstance(self.values, Exception):
            raise self.values
        return np.asarray(self.values, dtype)


@pytest.fixture(scope="module")
def bgr() -> ElfRuntime:
    return ElfRuntime(threads=1)


@pytest.fixture(scope="module")
def rgb() -> ElfRuntime:
    return ElfRuntime(threads=1, color="rgb")


def test_rgb_arrays_and_files_give_what_bgr_gives(bgr: ElfRuntime, rgb: ElfRuntime) -> None:
    wanted = bgr.detect(PALACE)
    alpha = np.full((*PALACE.shape[:2], 1), 255, np.uint8)
    for image in (RGB, np.dstack([RGB, alpha]), Tensor(RGB), ROOT / "demo" / "palace.jpg"):
        found = rgb.detect(image)
        np.testing.assert_array_equal(found.keypoints, wanted.keypoints)
        np.testing.assert_array_equal(found.descriptors, wanted.descriptors)
    np.testing.assert_array_equal(rgb.detect_batch([RGB])[0].keypoints, wanted.keypoints)
    np.testing.assert_array_equal(rgb.saliency(RGB), bgr.saliency(PALACE))
    points = wanted.keypoints[:5]
    np.testing.assert_array_equal(rgb.describe(RGB, points), bgr.describe(PALACE, points))
    assert len(ElfFeature2D(rgb).detect(RGB)) == len(wanted)
    assert not np.array_equal(bgr.saliency(RGB), bgr.saliency(PALACE))


def test_gray_has_no_order(bgr: ElfRuntime, rgb: ElfRuntime) -> None:
    gray = cv2.cvtColor(PALACE, cv2.COLOR_BGR2GRAY)
    np.testing.assert_array_equal(rgb.detect(gray).keypoints, bgr.detect(gray[:, :, None]).keypoints)


@pytest.mark.parametrize("color", ["bgr", "rgb"])
def test_pil_s_images_are_rgb_in_any_case(color: str) -> None:
    image = pytest.importorskip("PIL.Image")
    np.testing.assert_array_equal(read(image.fromarray(RGB), color=color), PALACE)
    with_alpha = image.fromarray(RGB).convert("RGBA")
    np.testing.assert_array_equal(read(with_alpha, color=color)[:, :, :3], PALACE)
    gray = image.fromarray(RGB).convert("L")
    np.testing.assert_array_equal(read(gray, color=color), np.asarray(gray))
    for mode in ("P", "CMYK", "LAB"):
        with pytest.raises(ImageError, match=f"in mode '{mode}': convert it to 'RGB'"):
            read(image.new(mode, (64, 64)), color=color)


def test_what_is_no_image_is_said() -> None:
    elf = ElfRuntime(TINY, threads=1)
    with pytest.raises(ImageError, match=r"a Tensor does not become an array: .*on a GPU"):
        elf.detect_batch([PALACE, Tensor(RuntimeError("it is on a GPU"))])
    with pytest.raises(ImageError, match="an image is a numpy array or a path, not list"):
        elf.detect([[1, 2], [3, 4]])  # type: ignore[arg-type]
    with pytest.raises(ImageError, match="shape"):
        elf.detect(Tensor(np.zeros(3)))
    with pytest.raises(SettingError, match="color is 'bgr' or 'rgb', not 'hsv'"):
        ElfRuntime(TINY, color="hsv")
