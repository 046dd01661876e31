"""Descriptors: a feature map interpolated at keypoints, L2-normalised."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]


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
    fx, fy = (x - x0).astype(np.float32)[:, None], (y - y0).astype(np.float32)[:, None]
    rows = feature_map.reshape(-1, dim)
    out = rows.take(y0 * width + x0, axis=0)
    out *= (1 - fx) * (1 - fy)
    corner = np.empty_like(out)
    for below, right, weight in ((y0, x1, fx * (1 - fy)), (y1, x0, (1 - fx) * fy), (y1, x1, fx * fy)):
        rows.take(below * width + right, axis=0, out=corner, mode="clip")  # no index is; "raise" would buffer
        corner *= weight
        out += corner
    return normalize_rows(out)


def normalize_rows(rows: Array) -> Array:
    """Rows scaled to unit L2 norm; a row of zeros stays one.  (N, D) -> (N, D) float32."""
    wide = rows.astype(np.float64)
    wide /= np.maximum(np.sqrt(np.einsum("nd,nd->n", wide, wide))[:, None], np.finfo(np.float32).tiny)
    return wide.astype(np.float32)
