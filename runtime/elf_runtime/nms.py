"""Exact greedy non-maximum suppression by rounds of local maxima."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]


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
    height, width = scores.shape
    flat = scores.ravel()
    taken: list[npt.NDArray[np.int64]] = []
    found = 0
    alive = np.where(mask, scores, -np.inf).astype(np.float32)
    window = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    while True:
        highest = cv2.dilate(alive, window, borderType=cv2.BORDER_CONSTANT, borderValue=-np.inf)
        peaks = np.flatnonzero((alive == highest) & (alive > -np.inf))
        if peaks.size == 0:
            break
        if np.unique(flat[peaks]).size < peaks.size:
            peaks = _first_of_ties(peaks, (height, width), window)
        taken.append(peaks)
        found += peaks.size
        chosen = np.zeros((height, width), np.uint8)
        chosen.ravel()[peaks] = 1
        covered = cv2.dilate(chosen, window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        alive[covered.view(np.bool_)] = -np.inf
    if not taken:
        return np.zeros((0, 2), np.int64), np.zeros(0, np.float32)
    index = np.sort(np.concatenate(taken))
    order = np.argsort(-flat[index], kind="stable")[:limit]
    index = index[order]
    return np.stack([index % width, index // width], axis=1), flat[index]


def _first_of_ties(
    peaks: npt.NDArray[np.int64], shape: tuple[int, int], window: npt.NDArray[np.uint8]
) -> npt.NDArray[np.int64]:
    """The peaks (sorted, raster order) with no earlier peak in their window.

    Two peaks in one window have the same score, each being the highest there: the earlier one is taken first.
    A peak that is left out here for an earlier one that is itself left out comes back in a later round.
    """
    rank = np.zeros(shape, np.float64)
    rank.ravel()[peaks] = np.arange(peaks.size, 0, -1)
    best = cv2.dilate(rank, window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    kept: npt.NDArray[np.int64] = peaks[rank.ravel()[peaks] == best.ravel()[peaks]]
    return kept
