"""An image on its way through the engine: made ready, the way back to its pixels, and the time of each stage."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import image as images
from .contract import InputSpec
from .errors import ImageError, SettingError
from .image import Array
from .params import DetectionParams


@dataclass(frozen=True)
class Work:
    """An image made ready: pixels at the working size, and the way back to the source."""

    pixels: Array  # (h, w, C)
    size: tuple[int, int]  # (H, W) of the source
    scale: float
    allowed: npt.NDArray[np.bool_] | None
    textured: bool

    @property
    def _ratio(self) -> npt.NDArray[np.float64]:
        (height, width), (h, w) = self.size, self.pixels.shape[:2]
        return np.array([w / width, h / height])

    def to_source(self, points: Array) -> Array:
        """Working to source pixels; the images' corners coincide, not their first pixels' centres."""
        return ((points + 0.5) / self._ratio - 0.5).astype(np.float32)

    def to_working(self, points: Array) -> Array:
        """Source to working pixels."""
        return ((points + 0.5) * self._ratio - 0.5).astype(np.float32)

    def length(self, pixels: int) -> int:
        """A length of the source image in working pixels; a positive one stays positive."""
        return max(1, round(pixels * self.scale)) if pixels else 0


def prepared(
    array: npt.NDArray[Any], params: DetectionParams, mask: npt.ArrayLike | None, spec: InputSpec, name: str
) -> Work:
    """The image at the working size, as the model `name` takes it.

    Raises
    ------
    ImageError
        On an image that is too small, or an image or mask that can't be processed.
    SettingError
        On a working scale, where the model takes one size only.
    """
    pixels = images.to_pixels(array, spec)
    size = (pixels.shape[0], pixels.shape[1])
    if min(size) < spec.min_size:
        raise ImageError(f"the image has {size[1]}x{size[0]} pixels; the smallest is {spec.min_size}x{spec.min_size}")
    if spec.is_fixed and params.scale != 1.0:
        raise SettingError(
            f"{name} takes images of {spec.width or 'any'}x{spec.height or 'any'} (width x height) only and "
            f"resizes to that: scale {params.scale:g} can't be chosen"
        )
    scale = max(params.scale, spec.min_size / min(size)) if params.scale < 1.0 else params.scale
    textured = not images.is_flat(pixels)
    pixels = images.resized(pixels, spec.size_for(size[0], size[1], scale))
    if spec.is_fixed:
        scale = float(np.sqrt(pixels.shape[0] / size[0] * pixels.shape[1] / size[1]))
    allowed = images.to_mask(mask, size, pixels.shape[:2]) if mask is not None else None
    return Work(pixels, size, scale, allowed, textured)


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
