"""An image on its way through the engine: made ready, the way back to its pixels, and the time of each stage."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.contract import ModelContract
from elf_runtime.errors import ImageError, SettingError
from elf_runtime.image import convert as images
from elf_runtime.image import masks
from elf_runtime.image.convert import Array
from elf_runtime.params import DetectionParams

from .contrast import window_for


@dataclass(frozen=True)
class Work:
    """An image made ready: pixels at the working size, and the way back to the source."""

    pixels: Array  # (h, w, C)
    size: tuple[int, int]  # (H, W) of the source
    scale: float
    mask: npt.NDArray[np.bool_] | None  # (H, W)
    textured: bool
    window: int  # side of the window that contrast is measured in, in working pixels
    gray_levels: float  # of 255, per unit of the pixels

    @property
    def _ratio(self) -> npt.NDArray[np.float64]:
        (height, width), (h, w) = self.size, self.pixels.shape[:2]
        return np.array([w / width, h / height])

    def to_source(self, points: npt.NDArray[Any]) -> Array:
        """Working to source pixels; the images' corners coincide, not their first pixels' centres."""
        return ((points + 0.5) / self._ratio - 0.5).astype(np.float32)

    def to_working(self, points: Array) -> Array:
        """Source to working pixels."""
        return ((points + 0.5) * self._ratio - 0.5).astype(np.float32)

    def radius(self, pixels: int) -> int:
        """A length of the source image to the nearest working pixel: at least 1 if positive, at most the image."""
        most: int = max(self.pixels.shape[:2])
        if pixels > most / self.scale:
            return most
        return max(1, round(pixels * self.scale)) if pixels else 0

    def margin(self, border: int) -> tuple[int, int]:
        """The fewest rows and columns along the edges without which every centre lies `border` source pixels inside.

        The centre of working pixel m lies at (m + 1/2) size / working - 1/2.  In integers: nothing is rounded.
        """
        sizes = zip(self.size, self.pixels.shape[:2], strict=True)
        rows, columns = (min(n, -((size - (2 * border + 1) * n) // (2 * size))) if border else 0 for size, n in sizes)
        return rows, columns

    def allowed(self) -> npt.NDArray[np.bool_] | None:
        """(h, w): where the mask has the source pixel of a working pixel's centre; None without a mask."""
        if self.mask is None:
            return None
        h, w = self.pixels.shape[:2]
        columns, rows = self._source_pixels(np.stack([np.arange(max(h, w))] * 2, axis=1)).T
        return np.asarray(self.mask[rows[:h, None], columns[:w]])

    def kept_inside(self, refined: Array, found: npt.NDArray[np.int64], border: int) -> Array:
        """The refined points, those that would leave what border and mask allow back at their whole pixels.

        Parameters
        ----------
        refined, found : (N, 2), (x, y) in working pixels
        border : int
            In source pixels; 0 holds none back.
        """
        stays = np.ones(len(found), np.bool_)
        if border:
            height, width = self.size
            first = min(border, max(self.size))
            source = self.to_source(refined)
            stays &= ((source >= first) & (source <= (width - 1 - first, height - 1 - first))).all(axis=1)
        if self.mask is not None:
            columns, rows = self._source_pixels(refined).T
            stays &= self.mask[rows, columns]
        return np.where(stays[:, None], refined, found.astype(np.float32))

    def _source_pixels(self, points: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        """The pixels (x, y) of the source image that working points lie in; between two, the even one."""
        height, width = self.size
        return np.clip(np.rint(self.to_source(points)), 0, (width - 1, height - 1)).astype(np.int64)


def prepared(
    array: npt.NDArray[Any], params: DetectionParams, mask: npt.ArrayLike | None, contract: ModelContract, name: str
) -> Work:
    """The image at the working size, as the model `name` takes it, and where keypoints may be.

    That is where the mask, if there is one, is not zero, nor the image's alpha, and not near the edge of that.

    Raises
    ------
    ImageError
        On an image that is too small, or an image or mask that can't be processed.
    SettingError
        On a working scale, where the model takes one size only.
    """
    spec = contract.input
    # One pixel stands for an image of one colour, which may be a gigabyte that was a kilobyte of file.
    blank = images.is_blank(array)
    pixels = images.to_pixels(array[:1, :1] if blank else array, spec)
    size = (array.shape[0], array.shape[1])
    if min(size) < spec.min_size:
        raise ImageError(f"the image has {size[1]}x{size[0]} pixels; the smallest is {spec.min_size}x{spec.min_size}")
    if spec.is_fixed and params.scale != 1.0:
        raise SettingError(
            f"{name} takes images of {spec.width or 'any'}x{spec.height or 'any'} (width x height) only and "
            f"resizes to that: scale {params.scale:g} can't be chosen"
        )
    scale = max(params.scale, spec.min_size / min(size)) if params.scale < 1.0 else params.scale
    working = spec.size_for(size[0], size[1], scale)
    textured = not (blank or images.is_flat(pixels))
    pixels = np.tile(pixels, (*working, 1)) if blank else images.resized(pixels, working)
    if spec.is_fixed:
        scale = float(np.sqrt(pixels.shape[0] / size[0] * pixels.shape[1] / size[1]))
    allowed = masks.seen(array, mask)
    if allowed is not None:
        allowed = masks.shrunk(allowed, _mask_border(params, contract.receptive_field, scale))
    window = window_for(contract.receptive_field, (pixels.shape[0], pixels.shape[1]))
    gray_levels = 255.0 / spec.value_range * images.unused_range(array)
    return Work(pixels, size, scale, allowed, textured, window, gray_levels)


def _mask_border(params: DetectionParams, receptive_field: float, scale: float) -> int:
    """How many source pixels keypoints keep away from a mask's edge: see `DetectionParams.mask_border`."""
    if not isinstance(params.mask_border, str):
        return params.mask_border
    if not receptive_field:
        return params.border
    return math.ceil((receptive_field - 1 + params.denoise[0] - 1) / 2 / scale)


def as_points(points: Any) -> Array:
    """(N, 2) float32 (x, y) of an array of such, or of a sequence of cv2.KeyPoint.

    Raises
    ------
    ImageError
        On another shape, or values that are NaN or infinite.
    """
    if isinstance(points, Sequence) and points and hasattr(points[0], "pt"):
        points = [p.pt for p in points]
    try:
        array = np.asarray(points, np.float32)
    except (TypeError, ValueError) as error:
        raise ImageError(f"points are an (N, 2) array of (x, y): {error}") from error
    if array.size == 0:
        return np.zeros((0, 2), np.float32)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ImageError(f"points are an (N, 2) array of (x, y), not of shape {array.shape}")
    if not np.isfinite(array).all():
        raise ImageError("some points are NaN or infinite")
    return array


class Stopwatch:
    """Adds up the wall time of named stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start
