"""From what a user has (a path, grey, 8 or 16 bits, float) to what the graph takes: float32 pixels, NHWC."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from .contract import InputSpec
from .errors import ImageError, first_line, reason
from .filetype import HEAD, description, open_regular
from .image_header import NEVER, SURELY, Header, is_cut_off, read_header

Array = npt.NDArray[np.float32]
ImageLike = npt.NDArray[Any] | str | os.PathLike[str]

MAX_PIXELS = 100_000_000  # of an image file, unless the caller allows more

_ROUNDING = 1e-6  # how far float pixels may lie outside [0, 1], where they are cut off


def read(
    image: ImageLike, *, ignore_exif: bool = False, max_pixels: int | None = MAX_PIXELS
) -> npt.NDArray[Any]:
    """The array itself, or the decoded file: BGR or grey, with its bit depth kept.

    Parameters
    ----------
    image : array or path
    ignore_exif : bool
        A file's pixels as they are stored, which is what COLMAP and homographies between files go by.  By default
        they are turned the way that its EXIF orientation says, as by `cv2.imread`: one of 640x427 with orientation 6
        is read as 427x640, and its keypoints are in that frame.  OpenCV turns TIFF files in any case.
    max_pixels : int, optional
        A file whose header says more is not decoded: a megabyte may unpack to gigabytes.  None is no limit.

    Returns
    -------
    (H, W), (H, W, 3) or, where the file has an alpha channel, (H, W, 4) array

    Raises
    ------
    ImageError
        If the file is missing, no regular file, no image, damaged or cut off, or has more than `max_pixels`.
    """
    if isinstance(image, np.ndarray):
        return image
    if not isinstance(image, (str, os.PathLike)):
        raise ImageError(f"an image is a numpy array or a path, not {type(image).__name__}")
    path = os.fsdecode(image)
    try:
        with open_regular(path) as file:
            header = read_header(file)
            if header:
                check_pixels((header.height, header.width), max_pixels, f"the {header.kind} file")
            file.seek(0)
            data = np.fromfile(file, np.uint8) if header else np.frombuffer(file.read(HEAD), np.uint8)
        return _decoded(data, header, ignore_exif)
    except (OSError, ImageError, MemoryError) as error:
        text = "not enough memory to read it" if isinstance(error, MemoryError) else reason(error)
        raise ImageError(f"{path}: {text}") from error


def check_pixels(shape: Sequence[int], max_pixels: int | None, what: str = "the image") -> None:
    """Raise ImageError on an image of (height, width, ...) that has more pixels than are allowed."""
    if max_pixels is not None and len(shape) > 1 and shape[0] * shape[1] > max_pixels:
        raise ImageError(
            f"{what} has {shape[1]}x{shape[0]} pixels, more than the limit of {max_pixels:,}; "
            "max_pixels (--max-pixels) sets another"
        )


def _decoded(data: npt.NDArray[np.uint8], header: Header | None, ignore_exif: bool) -> npt.NDArray[Any]:
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | (cv2.IMREAD_IGNORE_ORIENTATION if ignore_exif else 0)
    if header is None:
        what, unknown = description(data.tobytes()), "not an image that OpenCV can decode"
        raise ImageError(f"{unknown}: it is {what}" if what else unknown)
    whole = not is_cut_off(data.tobytes(), header)
    pixels = _opencv(data, flags) if whole else None
    if pixels is None:
        why = "damaged, or of a variant that OpenCV can't decode" if whole else "cut off: data are missing at its end"
        raise ImageError(f"the {header.kind} file is {why}")
    if header.alpha == NEVER:
        return pixels
    if header.transparent is not None and pixels.ndim == 2:
        top = np.iinfo(pixels.dtype).max
        alpha = np.where(pixels == header.transparent, 0, top).astype(pixels.dtype)
        return np.dstack([pixels, pixels, pixels, alpha])
    stored = _opencv(data, cv2.IMREAD_UNCHANGED)
    if stored is not None and stored.ndim == 3 and stored.shape[2] == 4:
        return _with_alpha(pixels, stored)
    if header.alpha == SURELY:
        raise ImageError(
            f"the {header.kind} file has an alpha channel that OpenCV does not decode; convert it, to a PNG in colour "
            "for example"
        )
    return pixels


def _opencv(data: npt.NDArray[np.uint8], flags: int) -> npt.NDArray[Any] | None:
    """The decoded pixels, or None."""
    try:
        return cv2.imdecode(data, flags)
    except cv2.error:
        return None


def _with_alpha(pixels: npt.NDArray[Any], stored: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """`pixels` with the alpha channel of the same file, which OpenCV reads from it as it is `stored` only.

    The way that the file's orientation turned `pixels` is the one that makes the stored colours equal to them.
    """
    if pixels.ndim == 2:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
    for turn in range(8):
        turned = np.rot90(stored.transpose(1, 0, 2) if turn & 4 else stored, turn & 3)
        if turned.shape[:2] == pixels.shape[:2] and np.array_equal(turned[:, :, :3], pixels):
            return np.ascontiguousarray(turned)
    return pixels if stored.shape[:2] != pixels.shape[:2] else np.dstack([pixels, stored[:, :, 3]])


@contextmanager
def named(image: ImageLike, place: str = "") -> Iterator[None]:
    """What is wrong with the image is said of its path, or of `place` in a batch."""
    label = place if isinstance(image, np.ndarray) else os.fsdecode(image)
    try:
        yield
    except (ImageError, MemoryError, cv2.error) as error:
        text = str(error) if isinstance(error, ImageError) else f"it can't be processed: {first_line(error)}"
        raise ImageError(f"{label}: {text}" if label else text) from error


def to_pixels(image: npt.NDArray[Any], spec: InputSpec) -> Array:
    """float32 pixels in the graph's range and colour order.

    Parameters
    ----------
    image : (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) array
        BGR as OpenCV reads it (a fourth channel is alpha: see `seen`); bool, uint8 and uint16 over their full range,
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


def is_flat(pixels: npt.NDArray[Any]) -> bool:
    """True where all pixels, (H, W) or (H, W, C), have the same colour: such an image has no saliency to speak of."""
    return bool((pixels[0] == pixels[0, 0]).all() and (pixels == pixels[0, 0]).all())


def is_blank(image: npt.NDArray[Any]) -> bool:
    """Whether it is an image of integers, as `to_pixels` takes it, of one colour; its alpha does not matter."""
    if image.dtype.kind != "u" or image.size == 0:
        return False
    if image.ndim == 2:
        return is_flat(image)
    return image.ndim == 3 and image.shape[2] in (1, 3, 4) and is_flat(image[:, :, :3])


def seen(image: npt.NDArray[Any], mask: npt.ArrayLike | None) -> npt.NDArray[np.bool_] | None:
    """Where a user's mask and the image's alpha allow keypoints, (H, W); None where that is everywhere.

    Raises
    ------
    ImageError
        As `to_mask`.
    """
    allowed = None if mask is None else to_mask(mask, (image.shape[0], image.shape[1]))
    if image.ndim == 3 and image.shape[2] == 4:
        opaque = image[:, :, 3] > 0
        if not opaque.all():
            allowed = opaque if allowed is None else allowed & opaque
    return allowed


def shrunk(mask: npt.NDArray[np.bool_], pixels: int) -> npt.NDArray[np.bool_]:
    """The mask without what lies within so many pixels, along x and y, of a place that it leaves out."""
    pixels = min(pixels, max(mask.shape))
    if pixels == 0:
        return mask
    # One axis at a time: OpenCV's time then grows with the sides of the window and not with its area.
    found = mask.view(np.uint8)
    for side in ((2 * pixels + 1, 1), (1, 2 * pixels + 1)):
        found = np.asarray(cv2.erode(found, np.ones(side, np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=1))
    return found.view(np.bool_)


def unused_range(image: npt.NDArray[Any]) -> float:
    """By how much 16-bit pixels could be multiplied: many cameras of 10 to 14 bits write them as they are.

    Returns
    -------
    float
        65535 over the largest number of as many bits as the image's maximum needs, 8 or more.  1 where the lowest two
        bits are not used, by a camera that fills 16 bits from the top, and for other dtypes.
    """
    if image.dtype.kind != "u" or image.dtype.itemsize != 2:
        return 1.0
    used = int(np.bitwise_or.reduce(image, axis=None))
    if used & 3 == 0:
        return 1.0
    return 65535.0 / float((1 << max(8, used.bit_length())) - 1)


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
