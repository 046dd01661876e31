"""From an image file to the pixels that are evaluated, and the matrix between the two."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_eval.coordinates import Float, Size, resize_matrix
from elf_eval.errors import EvalError

from .views import View, warp_image

IMAGE_ENDINGS = (".png", ".ppm", ".pgm", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
# Part of every image's identity: raise it when the preparation below changes.
PREPARATION = 1


def written_name(name: str) -> str:
    """The name that `elf-eval images` writes an image under: ``v_graf/1.png`` of ``v_graf/1.ppm``."""
    return Path(name).with_suffix(".png").as_posix()


@dataclass(frozen=True)
class ImageRef:
    """An image of a dataset: a file, and what is done to it before and after it is resized.

    Attributes
    ----------
    name : str
        Unique within its dataset, e.g. ``v_graf/1.png``; precomputed features are looked up by it, and by its
        `written_name`.
    path : Path
    quarter_turns : int
        First of all, the file is turned by so many times 90 degrees, counter-clockwise.
    view : View, optional
        Rotation, zoom or homography of the resized image.
    exact : bool
        Resize by OpenCV's bit-exact bilinear filter (derived datasets), whose pixels are the same on every machine
        and in every version.  The usual one differs from it by a grey level here and there.
    """

    name: str
    path: Path
    quarter_turns: int = 0
    view: View | None = None
    exact: bool = False

    def digest(self, size: Size | None) -> str:
        """Digest of the evaluated pixels: of the file's bytes and of all that is done to them."""
        try:
            data = self.path.read_bytes()
        except OSError as error:
            raise EvalError(f"{self.path}: {error.strerror or error}") from error
        view = None if self.view is None else repr(self.view)
        how = json.dumps([PREPARATION, size, self.quarter_turns, view, self.exact])
        return hashlib.sha256(hashlib.sha256(data).digest() + how.encode()).hexdigest()

    def open(self, size: Size | None) -> Image:
        """The image at the working size; nothing is decoded until its pixels are asked for."""
        return Image(self, size)


class Image:
    """An image ready for a method.

    Attributes
    ----------
    ref : ImageRef
    pixels : (H, W, 3) uint8, BGR
    to_working : (3, 3) float64
        Pixel coordinates of the file -> pixel coordinates of `pixels`.
    """

    def __init__(self, ref: ImageRef, size: Size | None) -> None:
        self.ref = ref
        self._wanted = size

    @property
    def name(self) -> str:
        return self.ref.name

    @property
    def size(self) -> Size:
        """(width, height) of `pixels`."""
        height, width = self.pixels.shape[:2]
        return width, height

    @property
    def pixels(self) -> npt.NDArray[np.uint8]:
        return self._prepared[0]

    @property
    def to_working(self) -> Float:
        return self._prepared[1]

    @cached_property
    def _prepared(self) -> tuple[npt.NDArray[np.uint8], Float]:
        pixels = read_image(self.ref.path)
        matrix = np.eye(3)
        for _ in range(self.ref.quarter_turns % 4):
            # Counter-clockwise: the right edge becomes the top one, (x, y) -> (y, W - 1 - x).
            matrix = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, pixels.shape[1] - 1.0], [0.0, 0.0, 1.0]]) @ matrix
            pixels = np.rot90(pixels)
        source = (pixels.shape[1], pixels.shape[0])
        if self._wanted is not None and self._wanted != source:
            matrix = resize_matrix(source, self._wanted) @ matrix
            bilinear = cv2.INTER_LINEAR_EXACT if self.ref.exact else cv2.INTER_LINEAR
            pixels = cv2.resize(np.ascontiguousarray(pixels), self._wanted, interpolation=bilinear)
        pixels = np.ascontiguousarray(pixels)
        if self.ref.view is not None:
            change = self.ref.view.matrix((pixels.shape[1], pixels.shape[0]))
            pixels, matrix = warp_image(pixels, change), change @ matrix
        return pixels, matrix


def read_image(path: Path) -> npt.NDArray[np.uint8]:
    """(H, W, 3) uint8 BGR.

    Raises
    ------
    EvalError
        If the file is missing or not an image.
    """
    try:
        data: Any = np.fromfile(path, np.uint8)
    except OSError as error:
        raise EvalError(f"{path}: {error.strerror or error}") from error
    # The dataset's homographies are between pixels as stored, so no EXIF rotation.
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    pixels = cv2.imdecode(data, flags) if data.size else None
    if pixels is None:
        raise EvalError(f"{path}: not an image that OpenCV can decode")
    return np.asarray(pixels, np.uint8)
