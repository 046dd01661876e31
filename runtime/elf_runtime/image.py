"""From what a user has (a path, grey, 8 or 16 bits, float) to what the graph takes: float32 pixels, NHWC."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from .contract import InputSpec
from .errors import ImageError, reason

Array = npt.NDArray[np.float32]
ImageLike = npt.NDArray[Any] | str | os.PathLike[str]

_ROUNDING = 1e-6  # how far float pixels may lie outside [0, 1], where they are cut off


def read(image: ImageLike, *, ignore_exif: bool = False) -> npt.NDArray[Any]:
    """The array itself, or the decoded file: BGR or grey, with its bit depth kept.

    Parameters
    ----------
    image : array or path
    ignore_exif : bool
        A file's pixels as they are stored, which is what COLMAP and homographies between files go by.  By default
        they are turned the way that its EXIF orientation says, as by `cv2.imread`: one of 640x427 with orientation 6
        is read as 427x640, and its keypoints are in that frame.  OpenCV turns TIFF files in any case.

    Returns
    -------
    (H, W), (H, W, 3) or (H, W, 4) array

    Raises
    ------
    ImageError
        If the file is missing or no image.
    """
    if isinstance(image, np.ndarray):
        return image
    if not isinstance(image, (str, os.PathLike)):
        raise ImageError(f"an image is a numpy array or a path, not {type(image).__name__}")
    path = os.fspath(image)
    try:
        data = np.fromfile(path, np.uint8)
    except (OSError, ValueError) as error:
        raise ImageError(f"{path}: {reason(error)}") from error
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | (cv2.IMREAD_IGNORE_ORIENTATION if ignore_exif else 0)
    try:
        pixels = cv2.imdecode(data, flags) if data.size else None
    except cv2.error as error:
        raise ImageError(f"{path}: not a readable image: {error}") from error
    if pixels is None:
        raise ImageError(f"{path}: not an image that OpenCV can decode")
    return np.asarray(pixels)


@contextmanager
def named(image: ImageLike, place: str = "") -> Iterator[None]:
    """What is wrong with the image is said of its path, or of `place` in a batch."""
    label = place if isinstance(image, np.ndarray) else os.fspath(image)
    try:
        yield
    except ImageError as error:
        raise ImageError(f"{label}: {error}" if label else str(error)) from error


def to_pixels(image: npt.NDArray[Any], spec: InputSpec) -> Array:
    """float32 pixels in the graph's range and colour order.

    Parameters
    ----------
    image : (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) array
        BGR as OpenCV reads it (a fourth channel is dropped); bool, uint8 and uint16 over their full range,
        floats in [0, 1], a rounding error of 1e-6 beyond cut off.  Any byte order.

    Returns
    -------
    (H, W, C) float32 in [0, spec.value_range], C = spec.channels

    Raises
    ------
    ImageError
        On another dtype or shape, an empty image, NaN or infinite pixels, or floats outside [0, 1].
    """
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (3, 4)):
        raise ImageError(f"an image has shape (H, W), (H, W, 3) or (H, W, 4), not {image.shape}")
    if image.dtype == np.bool_:
        image = image.astype(np.uint8) * np.uint8(255)
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    if image.dtype not in (np.uint8, np.uint16) and image.dtype.kind != "f":
        raise ImageError(f"an image is uint8, uint16 or float in [0, 1], not {image.dtype}")
    if 0 in image.shape[:2]:
        raise ImageError(f"the image is empty: shape {image.shape}")
    if image.ndim == 3 and image.shape[2] == 4:
        image = image[:, :, :3]
    if image.dtype.kind == "f":
        low, high = float(image.min()), float(image.max())
        if not (np.isfinite(low) and np.isfinite(high)):
            raise ImageError("the image has NaN or infinite pixels")
        if low < -_ROUNDING or high > 1.0 + _ROUNDING:
            raise ImageError(
                f"float images are in [0, 1], this one is in [{low:.9g}, {high:.9g}]; "
                "convert it, or pass 8 or 16 bits as uint8 or uint16"
            )
        if low < 0.0 or high > 1.0:
            image = image.clip(0.0, 1.0)
        full = 1.0
    else:
        full = float(np.iinfo(image.dtype).max)
    pixels = np.ascontiguousarray(image).astype(np.float32)
    if full != spec.value_range:
        pixels *= np.float32(spec.value_range / full)
    if spec.color == "gray":
        if pixels.ndim == 3:
            pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
        return np.asarray(pixels, np.float32)[:, :, None]
    if pixels.ndim == 2:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
    elif spec.color == "rgb":
        pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
    return np.asarray(pixels, np.float32)


def resized(pixels: Array, size: tuple[int, int]) -> Array:
    """`pixels` at the working size (h, w).  Area average when shrinking."""
    height, width = pixels.shape[:2]
    if size == (height, width):
        return pixels
    shrinks = size[0] * size[1] < height * width
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    out = np.asarray(cv2.resize(pixels, size[::-1], interpolation=method), np.float32)
    return out[:, :, None] if out.ndim == 2 else out


def is_flat(pixels: Array) -> bool:
    """True where all pixels (H, W, C) have the same colour: such an image has no saliency to speak of."""
    return bool((pixels[0] == pixels[0, 0]).all() and (pixels == pixels[0, 0]).all())


def to_mask(mask: Any, size: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """A user's mask as booleans; True = keypoints allowed.

    Parameters
    ----------
    mask : (H, W) or (H, W, 1) bool or integer array, of the source image's `size`

    Raises
    ------
    ImageError
        If it is of another shape or dtype.
    """
    array = np.asarray(mask)
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if array.shape != size:
        raise ImageError(f"the mask has shape {array.shape}, the image {size}")
    if array.dtype != np.bool_ and array.dtype.kind not in "ui":
        raise ImageError(f"a mask is bool or integer (non-zero = keypoints allowed), not {array.dtype}")
    return np.asarray(array != 0)
