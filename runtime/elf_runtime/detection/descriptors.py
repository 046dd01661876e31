"""Descriptors: a feature map interpolated at keypoints, L2-normalised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec
from elf_runtime.errors import ImageError, SettingError
from elf_runtime.model.outputs import check_descriptors

Array = npt.NDArray[np.float32]

# Values interpolated together: few enough to stay in the cache.
_BLOCK = 1 << 15


@dataclass(frozen=True)
class DescriptorMap:
    """A descriptor map (h, w, D) of one image; `model` is the model's name for messages."""

    values: Array
    spec: DescriptorSpec
    model: str

    def at(self, points: Array) -> Array:
        """The descriptors, (N, D), at working pixels (x, y).

        Raises
        ------
        ModelError
            If they are NaN or infinite, or the whole map is zero.
        """
        with np.errstate(invalid="ignore", over="ignore"):  # an error of its own follows
            rows = sample(self.values, points, self.spec.stride, self.spec.offset)
        check_descriptors(rows, self.values, self.spec, self.model)
        return rows


def sample(feature_map: Array, points: Array, stride: float, offset: float) -> Array:
    """Bilinear interpolation of a feature map at image points, by the network's geometry.

    The centre of cell ``i`` lies at pixel ``offset + i * stride``; a point outside the outermost cell centres
    takes the value at the nearest point between them.

    Parameters
    ----------
    feature_map : (h, w, D) float32
    points : (N, 2) float32, (x, y) in pixels of the image that the network saw, integer = pixel centre

    Returns
    -------
    (N, D) float32, rows of unit L2 norm (a row of zeros stays one)
    """
    height, width, dim = feature_map.shape
    cells = (np.asarray(points, np.float64) - offset) / stride
    x = np.clip(cells[:, 0], 0, width - 1)
    y = np.clip(cells[:, 1], 0, height - 1)
    x0 = np.minimum(x.astype(np.int64), max(width - 2, 0))
    y0 = np.minimum(y.astype(np.int64), max(height - 2, 0))
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = (x - x0).astype(np.float32), (y - y0).astype(np.float32)
    rows = feature_map.reshape(-1, dim)
    corners = np.stack([y0 * width + x0, y0 * width + x1, y1 * width + x0, y1 * width + x1], axis=1)
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    out = np.empty((len(x), dim), np.float32)
    step = max(1, _BLOCK // max(1, dim))
    # The blocks share their buffers, which stay in the cache.  No index is out of range: "clip" only saves a check.
    around, wide = np.empty((min(step, len(x)), 4, dim), np.float32), np.empty((min(step, len(x)), dim))
    for start in range(0, len(x), step):
        part = slice(start, start + step)
        total = out[part]
        size = len(total)
        np.take(rows, corners[part], axis=0, out=around[:size], mode="clip")
        np.einsum("nk,nkd->nd", weights[part], around[:size], out=total)
        total[...] = _unit(total, wide[:size])
    return out


def _unit(rows: Array, wide: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """`rows` at unit length, in float64, in `wide`."""
    wide[...] = rows
    wide /= np.maximum(np.sqrt(np.einsum("nd,nd->n", wide, wide))[:, None], np.finfo(np.float64).tiny)
    return wide


def as_points(points: Any) -> Array:
    """(N, 2) float32 (x, y) of an array of such, or of a sequence of cv2.KeyPoint.

    Raises
    ------
    ImageError
        On another shape, or values that are NaN or infinite.
    SettingError
        On a cv2.KeyPoint among others.
    """
    if isinstance(points, Sequence) and any(hasattr(p, "pt") for p in points):
        if not all(hasattr(p, "pt") for p in points):
            raise SettingError("points are all cv2.KeyPoint, or all (x, y)")
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
