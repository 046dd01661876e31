"""The calibration images as a user's, and another view of each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_export.calibration import CalibrationSet, decoded
from elf_runtime import InputSpec

Image = npt.NDArray[Any]  # (H, W) or (H, W, 3), of the file's own bit depth

LARGEST = 640  # pixels, of the longer side of a user's image


def sources(images: CalibrationSet, spec: InputSpec, scale: float) -> Iterator[Image]:
    """The images, of such a size that at the working scale they are as in calibration, or at most 640 pixels large.

    None is smaller than the graph takes: a tiny image is enlarged, and of a panorama only the central part is taken.
    """
    for path in images.files:
        image = decoded(path)
        longest = min(image.shape[:2]) * LARGEST // spec.min_size
        top, left = (max(size - longest, 0) // 2 for size in image.shape[:2])
        image = image[top : top + longest, left : left + longest]
        factor = 1 / scale if images.ready else min(1.0, LARGEST / max(image.shape[:2]))
        factor = max(factor, spec.min_size / min(image.shape[:2]))
        method = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
        resized = np.asarray(cv2.resize(image, None, fx=factor, fy=factor, interpolation=method))
        yield resized.clip(0, 1) if image.dtype.kind == "f" else resized


def view_of(image: Image, index: int) -> tuple[Image, npt.NDArray[np.float64]]:
    """Another view, brighter or darker and with noise, and the homography from the image to it.

    Noise and saturation go by the largest value that the camera gives: 255 in 8 bits, else the image's own, as 12 bits
    may lie in 16.
    """
    rng = np.random.default_rng(index)
    height, width = image.shape[:2]
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    moved = corners + rng.uniform(-0.08, 0.08, (4, 2)) * (width, height)
    homography = cv2.getPerspectiveTransform(corners, moved.astype(np.float32))
    view = cv2.warpPerspective(image, homography, (width, height), flags=cv2.INTER_LINEAR)
    most = 255.0 if image.dtype == np.uint8 else float(image.max())
    noisy = view * rng.uniform(0.7, 1.2) + rng.normal(0, 4, view.shape) * (most / 255)
    return np.clip(noisy, 0, most).astype(image.dtype), np.asarray(homography, np.float64)
