"""Exact greedy non-maximum suppression by rounds of local maxima."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]


# Window values to look at for ties in one round; beyond it, plateaus are so large that sorting is cheaper.
_MOST_TIE_CHECKS = 4_000_000


def greedy_nms(
    scores: Array, mask: npt.NDArray[np.bool_], radius: int, limit: int | None = None
) -> tuple[npt.NDArray[np.int64], Array]:
    """Greedy non-maximum suppression, equal to the plain loop.

    The plain loop takes the candidates by descending score, ties in raster order, and lets each one taken
    suppress all others in the square window of ``2 * radius + 1`` pixels around it.  Here whole rounds are
    taken at once: a candidate that precedes every remaining candidate in its window can't be suppressed any
    more, so the loop would take it too; what its window covers goes, and the next round looks at the rest.

    Parameters
    ----------
    scores : (H, W) float32, finite
    mask : (H, W) bool
        The candidates.
    radius : int, >= 0
    limit : int, optional
        Keep the first that many in the loop's order.

    Returns
    -------
    points : (K, 2) int64, (x, y) in the loop's order
    scores : (K,) float32, descending
    """
    width = scores.shape[1]
    flat = scores.ravel()
    taken: list[npt.NDArray[np.int64]] = []
    alive: npt.NDArray[np.floating] = np.where(mask, scores, -np.inf).astype(np.float32, copy=False)
    window = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    while True:
        highest = cv2.dilate(alive, window, borderType=cv2.BORDER_CONSTANT, borderValue=-np.inf)
        peaks = np.flatnonzero((alive == highest) & (alive > -np.inf))
        if peaks.size == 0:
            break
        if peaks.size * window.size > 2 * _MOST_TIE_CHECKS and alive.dtype == np.float32:
            alive = _ranks(alive)
            continue
        if alive.dtype == np.float32:
            peaks = peaks[~_preceded(alive, peaks, radius)]
        taken.append(peaks)
        chosen = np.zeros(scores.shape, np.uint8)
        chosen.ravel()[peaks] = 1
        covered = cv2.dilate(chosen, window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        alive[covered.view(np.bool_)] = -np.inf
    index = np.sort(np.concatenate(taken)) if taken else np.zeros(0, np.int64)
    order = np.argsort(-flat[index], kind="stable")[:limit]
    index = index[order]
    return np.stack([index % width, index // width], axis=1), flat[index]


def _preceded(
    alive: npt.NDArray[np.floating], peaks: npt.NDArray[np.int64], radius: int
) -> npt.NDArray[np.bool_]:
    """For each peak (the highest of its window): does an equal candidate come before it in raster order?"""
    width = alive.shape[1]
    framed = np.pad(alive, radius, constant_values=-np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(framed, (radius + 1, 2 * radius + 1))
    # The rows from the window's top to the peak's own, which holds the peak at [radius, radius].
    above = windows[peaks // width, peaks % width].reshape(peaks.size, -1)[:, : (2 * radius + 1) * radius + radius]
    found: npt.NDArray[np.bool_] = (above == alive.ravel()[peaks][:, None]).any(axis=1)
    return found


def _ranks(alive: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Candidates numbered in the loop's order, the first one highest: the same order without ties."""
    candidates = np.flatnonzero(alive > -np.inf)
    order = candidates[np.argsort(-alive.ravel()[candidates], kind="stable")]
    ranks = np.full(alive.shape, -np.inf)
    ranks.ravel()[order] = np.arange(order.size, 0, -1)
    return ranks
