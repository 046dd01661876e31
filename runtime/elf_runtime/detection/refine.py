"""Sub-pixel position of maxima."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .rounding import rounded

Array = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]

FARTHEST = 0.5  # working pixels, along each axis
FLAT = 2.0**-12
"""Where the second difference is less than this share of the value, it may be the rounding of floats."""


def quadratic_peaks(scores: Array, points: npt.NDArray[np.int64]) -> Array:
    """Move each maximum to the top of a quadratic surface through its score and those around it.

    With g and H the central differences of first and second order, the top lies at -H^-1 g, as in Brown, Lowe,
    "Invariant features from interest point groups", BMVC 2002; along each axis it is held to half a pixel.  Where the
    surface has no top, because the point is no maximum of its 3x3 pixels (the edge of a mask), lies at the map's border
    or on something flat in a direction (an edge), it is a parabola's along each axis where that has one, and the point
    stays along the other.  Maxima are those of `rounded` scores, and `FLAT` says what is flat: tops that only the
    rounding of floats makes are none.

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
    rows = np.clip(y[:, None] + [-1, 0, 1], 0, height - 1)
    columns = np.clip(x[:, None] + [-1, 0, 1], 0, width - 1)
    around = scores[rows[:, :, None], columns[:, None, :]]  # (N, 3, 3)
    ranks = rounded(around)
    reached = ranks <= ranks[:, 1:2, 1:2]
    around = around.astype(np.float64)
    inside = np.stack([(x > 0) & (x < width - 1), (y > 0) & (y < height - 1)], axis=1)
    highest = np.stack([reached[:, 1].all(axis=1), reached[:, :, 1].all(axis=1)], axis=1)  # along x and y
    steps = _along_axes(around, inside & highest)
    whole = inside.all(axis=1) & reached.all(axis=(1, 2))
    steps[whole] = _of_surface(around[whole], steps[whole])
    return (points + steps).astype(np.float32)


def parabola_tops(before: Float, at: Float, after: Float) -> Float:
    """(N,): where the parabolas through three values are highest, from the middle ones; 0 where one has no top."""
    curvature = before - 2 * at + after
    return np.divide(before - after, 2 * curvature, out=np.zeros(len(at)), where=curvature < 0)


def _differences(around: Float) -> tuple[Float, Float]:
    """(N, 2) of first and second order along x and y."""
    before, after = (np.stack([around[:, 1, i], around[:, i, 1]], axis=1) for i in (0, 2))
    return (after - before) / 2, before - 2 * around[:, 1, 1, None] + after


def _along_axes(around: Float, highest: npt.NDArray[np.bool_]) -> Float:
    """The tops of the parabolas along x and y, 0 where there is none."""
    slope, curvature = _differences(around)
    peaked = highest & (curvature < -FLAT * around[:, 1, 1, None])
    return np.clip(np.divide(-slope, curvature, out=np.zeros_like(slope), where=peaked), -FARTHEST, FARTHEST)


def _of_surface(around: Float, otherwise: Float) -> Float:
    """The tops of the surfaces through maxima, and `otherwise` where a surface has none."""
    slope, curvature = _differences(around)
    mixed = (around[:, 0, 0] - around[:, 0, 2] - around[:, 2, 0] + around[:, 2, 2]) / 4
    determinant = curvature[:, 0] * curvature[:, 1] - mixed**2
    # The product of the principal curvatures over their sum, which is about the smaller one.
    topped = (curvature < 0).all(axis=1) & (determinant > -FLAT * around[:, 1, 1] * curvature.sum(axis=1))
    towards = mixed[:, None] * slope[:, ::-1] - curvature[:, ::-1] * slope
    tops = np.divide(towards, determinant[:, None], out=np.zeros_like(slope), where=topped[:, None])
    return np.where(topped[:, None], np.clip(tops, -FARTHEST, FARTHEST), otherwise)
