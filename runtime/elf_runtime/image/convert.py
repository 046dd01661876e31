"""From an image as a user has it (grey, 8 or 16 bits, float) to the pixels that the graph takes: float32, NHWC."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.contract import InputSpec
from elf_runtime.errors import ImageError

Array = npt.NDArray[np.float32]

_ROUNDING = 1e-6  # how far float pixels may lie outside [0, 1], where they are cut off


def to_pixels(image: npt.NDArray[Any], spec: InputSpec) -> Array:
    """float32 pixels in the graph's range and colour order.

    Parameters
    ----------
    image : (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) array
        BGR as OpenCV reads it (a fourth channel is alpha: see `masks.seen`); bool, uint8, uint16 over their full range,
        floats in [0, 1], a rounding error of 1e-6 beyond cut off.  Any byte order.

    Returns
    -------
    (H, W, C) float32 in [0, spec.value_range], C = spec.channels

    Raises
    ------
    ImageError
        On another dtype or shape, an empty image, NaN or infinite pixels, or floats outside [0, 1].
    """
    image = _native(image)
    if image.ndim == 3 and image.shape[2] == 4:
        if image.dtype.kind == "f" and not np.isfinite(image[:, :, 3]).all():
            raise ImageError("the image's alpha has NaN or infinite values")
        image = image[:, :, :3]
    if image.dtype.kind == "f":
        image, full = _within_one(image), 1.0
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


def checked(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The image as `to_pixels` takes it, without its alpha: (H, W) or (H, W, 3), of uint8, uint16 or floats in [0, 1].

    Raises
    ------
    ImageError
        As `to_pixels`.
    """
    image = _native(image)
    image = image[:, :, :3] if image.ndim == 3 else image
    return _within_one(image) if image.dtype.kind == "f" else image


def _native(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The image as (H, W), (H, W, 3) or (H, W, 4), of uint8, uint16 or floats in this machine's byte order."""
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
    return image


def _within_one(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Float pixels in [0, 1], what lies outside by a rounding error being cut off."""
    low, high = float(image.min()), float(image.max())
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ImageError("the image has NaN or infinite pixels")
    if low < -_ROUNDING or high > 1.0 + _ROUNDING:
        raise ImageError(
            f"float images are in [0, 1], this one is in [{low:.9g}, {high:.9g}]; "
            "convert it, or pass 8 or 16 bits as uint8 or uint16"
        )
    return image.clip(0.0, 1.0) if low < 0.0 or high > 1.0 else image


def resized(pixels: Array, size: tuple[int, int]) -> Array:
    """`pixels` at the working size (h, w).  Area average when shrinking."""
    height, width = pixels.shape[:2]
    if size == (height, width):
        return pixels
    shrinks = size[0] * size[1] < height * width
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    out = np.asarray(cv2.resize(pixels, size[::-1], interpolation=method), np.float32)
    return out[:, :, None] if out.ndim == 2 else out


def is_flat(pixels: npt.NDArray[Any]) -> bool:
    """True where all pixels, (H, W) or (H, W, C), have the same colour: such an image has no saliency to speak of."""
    return bool((pixels[0] == pixels[0, 0]).all() and (pixels == pixels[0, 0]).all())


def is_blank(image: npt.NDArray[Any]) -> bool:
    """Whether an image of integers has one colour only, whatever its alpha."""
    if image.dtype.kind != "u" or image.size == 0:
        return False
    if image.ndim == 2:
        return is_flat(image)
    return image.ndim == 3 and image.shape[2] in (1, 3, 4) and is_flat(image[:, :, :3])


def unused_range(image: npt.NDArray[Any]) -> float:
    """The factor that would stretch 16-bit pixels over their range: cameras of 10 to 14 bits often leave it unused.

    Returns
    -------
    float
        65535 over the largest number of as many bits as the image's maximum needs, 8 or more; 1 for other dtypes.
    """
    if image.dtype.kind != "u" or image.dtype.itemsize != 2:
        return 1.0
    return 65535.0 / float((1 << max(8, int(image.max()).bit_length())) - 1)
