"""Sub-pixel position of maxima."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]


def parabola_peaks(scores: Array, points: npt.NDArray[np.int64]) -> Array:
    """Move each maximum to the top of the parabola through its score and its two neighbours', along x and y.

    With a, b, c the scores at -1, 0, 1, the top lies at (a - c) / (2 (a - 2 b + c)).  It is at most half a pixel
    away where b is the largest; where it is not (a plateau, the edge of a mask) or at the map's border, the point
    stays along that axis.

    Parameters
    ----------
    scores : (H, W) float32
    points : (N, 2) int64, (x, y)

    Returns
    -------
    (N, 2) float32, (x, y)
    """
    height, width = scores.shape
    x, y = points[:, 0], points[:, 1]
    centre = scores[y, x].astype(np.float64)
    moved = points.astype(np.float64)
    for axis, (dx, dy, at, size) in enumerate(((1, 0, x, width), (0, 1, y, height))):
        before = scores[np.maximum(y - dy, 0), np.maximum(x - dx, 0)].astype(np.float64)
        after = scores[np.minimum(y + dy, height - 1), np.minimum(x + dx, width - 1)].astype(np.float64)
        curvature = before - 2 * centre + after
        peaked = (centre >= before) & (centre >= after) & (curvature < 0) & (at > 0) & (at < size - 1)
        moved[peaked, axis] += (before - after)[peaked] / (2 * curvature[peaked])
    return moved.astype(np.float32)
