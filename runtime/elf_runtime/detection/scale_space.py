"""How large the thing under a keypoint is, and where its centre lies: differences of Gaussians over two octaves."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from .refine import parabola_tops, quadratic_peaks

Array = npt.NDArray[np.float32]
Wide = npt.NDArray[np.float64]

MIDDLE = 2.5  # standard deviation in pixels: a keypoint whose blob has this one is as large as its level's window
OCTAVES = 1.0  # that a blob may be smaller or larger
_STEPS = 4  # an octave
_CLIMB = 3  # whole pixels that the way to a blob's centre may take


class ScaleSpace:
    """The blobs of an image: |G(k s) - G(s / k)| at every pixel (Lowe, IJCV 2004, section 3).

    A difference of Gaussians is, but for a factor, the Laplacian of the image blurred by s, times s^2, whose maxima
    over s are the characteristic scales of Lindeberg (IJCV 1998).  Here s = `MIDDLE` 2^o for o from -`OCTAVES` to
    `OCTAVES` in steps of k^2.

    Parameters
    ----------
    pixels : (h, w, C) float32
        The mean of the channels is taken; the border is mirrored.
    """

    def __init__(self, pixels: Array) -> None:
        most = round(OCTAVES * _STEPS) + 1  # one step beyond: a maximum has neighbours
        self._octaves: Wide = np.arange(-most, most + 1) / _STEPS
        sigmas = MIDDLE * 2 ** (np.append(self._octaves, self._octaves[-1] + 1 / _STEPS) - 0.5 / _STEPS)
        blurred, before = pixels.mean(axis=2, dtype=np.float32), 0.0
        steps = []
        for sigma in sigmas.tolist():
            finer, blurred = blurred, _blur(blurred, math.sqrt(sigma**2 - before**2))
            before = sigma
            steps.append(np.abs(blurred - finer))
        self._response: Array = np.stack(steps[1:])  # the first is from the image itself

    def octaves(self, points: Array) -> Wide:
        """(N,): the o of the strongest maximum over the scales at each point, (N, 2) as (x, y), refined by a parabola.

        At the end of the range, the stronger one, where there is no maximum inside.  Points outside the image stand at
        its edge.
        """
        at = _read(self._response, points)
        before, inner, after = at[:-2], at[1:-1], at[2:]
        is_peak = (inner >= before) & (inner > after)
        best = np.where(is_peak, inner, -1.0).argmax(axis=0)
        own = (best, np.arange(len(points)))
        inside: Wide = self._octaves[best + 1] + parabola_tops(before[own], inner[own], after[own]) / _STEPS
        end = np.where(inner[0] >= inner[-1], -OCTAVES, OCTAVES)
        return np.clip(np.where(is_peak.any(axis=0), inside, end), -OCTAVES, OCTAVES)

    def centres(self, points: Array, octaves: Wide) -> Array:
        """(N, 2): the maximum of the response at MIDDLE 2^o that is reached from each point by steepest ascent.

        Refined as in `refine`; the point itself where the maximum is farther than MIDDLE 2^o, or at the image's edge.
        """
        found = points.copy()
        level = np.rint((octaves - self._octaves[0]) * _STEPS).astype(np.int64)
        for number in np.unique(level):
            own = level == number
            found[own] = _climbed(self._response[number], points[own], MIDDLE * 2 ** octaves[own])
        return found


def _climbed(response: Array, points: Array, farthest: Wide) -> Array:
    """(N, 2): the tops that are reached from points by steepest ascent, within (N,) pixels, else the points."""
    height, width = response.shape
    if min(height, width) < 3:
        return points
    around = np.arange(-1, 2)
    inside = np.clip(np.rint(points), 1, (width - 2, height - 2)).astype(np.int64)
    step = np.full(len(points), 4)
    for _ in range(_CLIMB + 1):
        rows, columns = inside[:, 1, None] + around, inside[:, 0, None] + around
        step = response[rows[:, :, None], columns[:, None, :]].reshape(-1, 9).argmax(axis=1)
        inside = np.clip(inside + np.stack([step % 3, step // 3], axis=1) - 1, 1, (width - 2, height - 2))
    found = quadratic_peaks(response, inside)
    stays = (step != 4) | (np.linalg.norm(found - points, axis=1) > farthest)
    return np.where(stays[:, None], points, found)


def _blur(image: Array, sigma: float) -> Array:
    side = 2 * math.ceil(3 * sigma) + 1
    found = cv2.GaussianBlur(image, (side, side), sigma, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(found, np.float32)


def _read(maps: Array, points: Array) -> Wide:
    """(K, N): of maps, (K, h, w), bilinearly; points outside stand at the edge."""
    last = np.array(maps.shape[:0:-1]) - 1  # (x, y)
    inside = np.clip(points.astype(np.float64), 0, last)
    first = np.minimum(inside.astype(np.int64), np.maximum(last - 1, 0))
    (x, y), (right, below), (across, down) = first.T, np.minimum(first + 1, last).T, (inside - first).T
    above = maps[:, y, x] * (1 - across) + maps[:, y, right] * across
    under = maps[:, below, x] * (1 - across) + maps[:, below, right] * across
    return np.asarray(above * (1 - down) + under * down, np.float64)
