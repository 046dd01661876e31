"""Image files: checked before they are decoded, and decoded with their bit depth and alpha."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ImageError, first_line, reason
from elf_runtime.files.kind import HEAD, description, open_regular

from .header import NEVER, SURELY, Header, is_cut_off, read_header


class BecomesArray(Protocol):
    """What numpy makes an array of, such as a tensor on the CPU."""

    def __array__(self) -> npt.NDArray[Any]: ...


class HasArrayInterface(Protocol):
    """Likewise, such as an image of PIL's."""

    @property
    def __array_interface__(self) -> dict[str, Any]: ...


ImageLike = npt.NDArray[Any] | BecomesArray | HasArrayInterface | str | os.PathLike[str]
COLORS = ("bgr", "rgb")
_PIL_MODES = ("1", "L", "I;16", "RGB", "RGBA")

MAX_PIXELS = 100_000_000  # of an image, unless the caller allows more


def read(
    image: ImageLike, *, ignore_exif: bool = False, max_pixels: int | None = MAX_PIXELS, color: str = "bgr"
) -> npt.NDArray[Any]:
    """The array itself, or the decoded file: BGR or grey, with its bit depth kept.

    Parameters
    ----------
    image : array, object that numpy makes one of, or path
        PIL's images are RGB, whatever `color` says.
    ignore_exif : bool
        A file's pixels as they are stored, which is what COLMAP and homographies between files go by.  By default
        they are turned the way that its EXIF orientation says, as by `cv2.imread`: one of 640x427 with orientation 6
        is read as 427x640, and its keypoints are in that frame.  OpenCV turns TIFF files in any case.
    max_pixels : int, optional
        A file whose header says more is not decoded: a megabyte may unpack to gigabytes.  None is no limit.
    color : "bgr" or "rgb"
        The order of an array's channels.

    Returns
    -------
    (H, W), (H, W, 3) or, where the file has an alpha channel, (H, W, 4) array

    Raises
    ------
    ImageError
        If the file is missing, no regular file, no image, damaged or cut off, or has more than `max_pixels`; if the
        object is none of these, or an image of PIL's of another mode than 1, L, I;16, RGB and RGBA.
    """
    if isinstance(image, (str, os.PathLike)):
        return ImageFile(image, max_pixels).decoded(ignore_exif)
    array = _array_of(image)
    if (color == "rgb" or _is_pil(image)) and array.ndim == 3 and array.shape[2] in (3, 4):
        return array[:, :, [2, 1, 0, 3][: array.shape[2]]]
    return array


def _array_of(image: Any) -> npt.NDArray[Any]:
    if isinstance(image, np.ndarray):
        return image
    if _is_pil(image) and image.mode not in _PIL_MODES:
        raise ImageError(f"an image of PIL's in mode {image.mode!r}: convert it to 'RGB' or 'L'")
    if not (hasattr(image, "__array__") or hasattr(image, "__array_interface__")):
        raise ImageError(f"an image is a numpy array or a path, not {type(image).__name__}")
    try:
        return np.asarray(image)
    except Exception as error:  # whatever the object's own code raises
        raise ImageError(f"a {type(image).__name__} does not become an array: {reason(error)}") from error


def _is_pil(image: Any) -> bool:
    return type(image).__module__.partition(".")[0] == "PIL" and hasattr(image, "mode")


class ImageFile:
    """An image file that is read and not decoded yet.

    Parameters
    ----------
    path : path
    max_pixels : int, optional
        See `read`.
    data : bytes, optional
        What is in the file, where it is not on this machine; `path` is a name for messages then.

    Raises
    ------
    ImageError
        As `read`, here and in `decoded`.
    """

    def __init__(
        self, path: str | os.PathLike[str], max_pixels: int | None = MAX_PIXELS, data: bytes | None = None
    ) -> None:
        self.path = os.fsdecode(path)
        with image_errors(self.path), open_regular(self.path) if data is None else BytesIO(data) as file:
            self._header = read_header(file)
            if self._header:
                check_pixels((self._header.height, self._header.width), max_pixels, f"the {self._header.kind} file")
            file.seek(0)
            if self._header and data is None:
                self._data = np.fromfile(file, np.uint8)
            else:  # of what is no image, its first bytes are enough to say what it is
                self._data = np.frombuffer(file.read(-1 if self._header else HEAD), np.uint8)

    @property
    def sha256(self) -> str:
        """SHA-256 of the file's bytes."""
        return hashlib.sha256(self._data.data).hexdigest()

    def decoded(self, ignore_exif: bool = False) -> npt.NDArray[Any]:
        """The pixels, as `read` gives them."""
        with image_errors(self.path):
            return _decoded(self._data, self._header, ignore_exif)


@contextmanager
def image_errors(image: ImageLike, place: str = "") -> Iterator[None]:
    """Say what is wrong with an image as an ImageError that begins with its path, or `place` for an array."""
    label = os.fsdecode(image) if isinstance(image, (str, os.PathLike)) else place
    try:
        yield
    except (ImageError, OSError, MemoryError, cv2.error) as error:
        text = (
            reason(error) if isinstance(error, (ImageError, OSError)) else f"it can't be processed: {first_line(error)}"
        )
        raise ImageError(f"{label}: {text}" if label else text) from error


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
    if header.misread:
        raise ImageError(f"it is {header.misread}, which OpenCV misreads; convert it, to a PNG for example")
    whole = not is_cut_off(data.tobytes(), header)
    pixels = _opencv(data, flags) if whole else None
    if pixels is None and whole and header.alpha != NEVER:
        pixels = _opencv(data, cv2.IMREAD_UNCHANGED)  # some are decoded with their alpha only
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
    """`pixels` with the alpha channel of the same file, which OpenCV decodes only as it is `stored`, not turned.

    The turn that makes the stored colours equal to `pixels` is the one that the file's orientation asks for.
    """
    if pixels.ndim == 2:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
    for turn in range(8):
        turned = np.rot90(stored.transpose(1, 0, 2) if turn & 4 else stored, turn & 3)
        if turned.shape[:2] == pixels.shape[:2] and np.array_equal(turned[:, :, :3], pixels):
            return np.ascontiguousarray(turned)
    return pixels if stored.shape[:2] != pixels.shape[:2] else np.dstack([pixels, stored[:, :, 3]])
