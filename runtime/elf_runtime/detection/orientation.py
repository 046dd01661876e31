"""The orientation of a keypoint: the direction that most of the gradients around it have."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .refine import parabola_tops

Array = npt.NDArray[np.float32]
Wide = npt.NDArray[np.float64]

BINS = 36  # of 10 degrees
_SMOOTHINGS = 6  # by (1, 2, 1) / 4 each: a standard deviation of 17 degrees
_BLOCK = 1 << 18  # gradients that are looked at together


def orientations(pixels: Array, points: npt.NDArray[np.floating], sigma: npt.ArrayLike) -> Array:
    """The peak of the histogram of gradient directions around each point (Lowe, IJCV 2004, section 5).

    With g the mean of the channels and g_x, g_y its central differences, each pixel within 3 sigma of the point's
    pixel adds |grad g| exp(-d^2 / (2 sigma^2)), d its distance, to the two bins nearest to its direction, by how near
    they are.  The highest bin of the smoothed histogram is refined by a parabola through its neighbours.  Unlike
    Lowe's, a point has one orientation.

    Parameters
    ----------
    pixels : (h, w, C) float32
    points : (N, 2), (x, y) in pixels
        Those outside the image stand at its edge.
    sigma : float, or (N,) of few different values
        In pixels.

    Returns
    -------
    (N,) float32
        Degrees in [0, 360), clockwise from the x axis in the image; 0 where nothing has a direction.
    """
    gradients = _gradients(pixels)
    found = np.empty(len(points), np.float32)
    sigmas = np.broadcast_to(np.asarray(sigma, np.float64), len(points))
    for one in np.unique(sigmas):
        found[sigmas == one] = _of_one_sigma(gradients, points[sigmas == one], float(one))
    return found


def _of_one_sigma(gradients: tuple[Array, Array], points: npt.NDArray[np.floating], sigma: float) -> Array:
    height, width = gradients[0].shape
    reach = round(3 * sigma)
    offset = np.arange(-reach, reach + 1)
    squares = offset[:, None] ** 2 + offset**2
    weight = np.exp(-squares / (2 * sigma**2)) * (squares <= reach**2)
    # Nothing comes from outside the image.
    strength, direction = (np.pad(part, reach) for part in gradients)
    columns, rows = np.clip(np.rint(points), 0, (width - 1, height - 1)).astype(np.int64).T
    around = (offset[:, None] + reach) * strength.shape[1] + offset + reach
    found = np.empty(len(points), np.float32)
    step = max(1, _BLOCK // around.size)
    for start in range(0, len(points), step):
        part = slice(start, start + step)
        index = (rows[part] * strength.shape[1] + columns[part])[:, None, None] + around
        found[part] = _peaks(_histograms(direction.ravel()[index], strength.ravel()[index] * weight))
    return found


def _gradients(pixels: Array) -> tuple[Array, Array]:
    """Strength of the gradient, and its direction in bins, [0, BINS]; (h, w) both."""
    g = np.pad(pixels.mean(axis=2), 1, mode="reflect")
    along_x, along_y = (g[1:-1, 2:] - g[1:-1, :-2]) / 2, (g[2:, 1:-1] - g[:-2, 1:-1]) / 2
    direction = np.arctan2(along_y, along_x) / np.float32(2 * np.pi) * BINS % BINS
    return np.hypot(along_x, along_y), direction


def _histograms(direction: Array, strength: Wide) -> Wide:
    """(N, BINS) of the gradients around N points, (N, side, side)."""
    lower = np.floor(direction).astype(np.int64)
    upper_share = direction - lower
    first = np.arange(len(direction))[:, None, None] * BINS
    size = len(direction) * BINS
    total = np.bincount((first + lower % BINS).ravel(), (strength * (1 - upper_share)).ravel(), size)
    total += np.bincount((first + (lower + 1) % BINS).ravel(), (strength * upper_share).ravel(), size)
    histogram: Wide = total.reshape(-1, BINS).astype(np.float64)
    for _ in range(_SMOOTHINGS):
        histogram = (np.roll(histogram, 1, axis=1) + 2 * histogram + np.roll(histogram, -1, axis=1)) / 4
    return histogram


def _peaks(histogram: Wide) -> Array:
    """Degrees of the highest bin of each, the first of equal ones: the top of the parabola through its neighbours."""
    row, top = np.arange(len(histogram)), histogram.argmax(axis=1)
    before, at, after = (histogram[row, (top + shift) % BINS] for shift in (-1, 0, 1))
    degrees = np.asarray((top + parabola_tops(before, at, after)) * (360 / BINS) % 360, np.float32)
    return np.where(degrees < 360, degrees, np.float32(0))  # float32 may round up to it
