"""Exact greedy non-maximum suppression by rounds of local maxima."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]
Scores = npt.NDArray[np.number]
Index = npt.NDArray[np.intp]

# Where fewer than a 64th of the pixels are left, looking around each of them is cheaper than a dilation of the map.
_DENSE = 64
# Values looked at together: few enough to stay in the cache.  The result does not depend on it.
_BLOCK = 1 << 16


def window_maxima(scores: Scores, radius: int) -> npt.NDArray[np.bool_]:
    """(H, W) bool: which scores no other exceeds in the square window of ``2 * radius + 1`` pixels around them."""
    window = np.ones((2 * radius + 1,) * 2, np.uint8)
    return np.asarray(scores >= cv2.dilate(scores, window))


def greedy_nms(
    scores: Scores, mask: npt.NDArray[np.bool_], radius: int, limit: int | None = None
) -> tuple[npt.NDArray[np.int64], Scores]:
    """Greedy non-maximum suppression, equal to the plain loop.

    The plain loop takes the candidates by descending score, ties in raster order, and lets each one taken
    suppress all others in the square window of ``2 * radius + 1`` pixels around it.  Here whole rounds are
    taken at once: a candidate that precedes every remaining candidate in its window can't be suppressed any
    more, so the loop would take it too; what its window covers goes, and the next round looks at the rest.

    Once `limit` are taken, candidates below the limit-th best score so far go too.  They would not be kept: what is
    taken later can only raise that score.  And they suppress none that is kept: a candidate suppresses only those
    that it precedes, and these score no higher.

    Distinct scores have at most one peak in any ``radius + 1`` pixels square, so that fewer than 4 of their windows
    share a pixel.  Where there are more, large plateaus would be searched for ties again and again; numbering the
    candidates in the loop's order, once, is cheaper there and keeps that order.

    Parameters
    ----------
    scores : (H, W) float32 or float64, finite; or uint8, above 0 where `mask`
    mask : (H, W) bool
        The candidates.
    radius : int, >= 0
        One that reaches beyond the map suppresses no more than the whole map.
    limit : int, >= 0, optional
        Keep the first that many in the loop's order.

    Returns
    -------
    points : (K, 2) int64, (x, y) in the loop's order
    scores : (K,), of the dtype given, descending
    """
    taken, best = np.zeros(0, np.intp), np.zeros(0, scores.dtype)
    if limit == 0 or not mask.any():
        return np.zeros((0, 2), np.int64), best
    radius = min(radius, max(scores.shape) - 1)
    frame = _Frame(scores, mask, radius)
    size, least = frame.values.size, frame.least
    left: Index | None = None  # the candidates, once they are few
    while left is None or left.size:
        if left is None:
            remaining = frame.values >= least
            if np.count_nonzero(remaining) * _DENSE <= size:
                left = np.flatnonzero(remaining)
        if left is None:
            peaks = frame.highest(remaining)
            if peaks.size * frame.side**2 > 4 * size:
                points, _ = greedy_nms(_numbered(scores, mask), mask, radius, limit)
                return points, scores[points[:, 1], points[:, 0]]
            if limit is not None and peaks.size > limit:
                # The best are enough for now: with them taken, the rest is most often below the limit.
                worth = frame.values[peaks]
                peaks = peaks[worth >= np.partition(worth, -limit)[-limit]]
        else:
            peaks = left
        peaks = frame.first(peaks)
        taken, best = np.append(taken, peaks), np.append(best, frame.values[peaks])
        frame.clear(peaks)
        if limit is not None and best.size >= limit:
            least = np.partition(best, -limit)[-limit]
        if left is not None:
            left = left[frame.values[left] >= least]
    order = np.lexsort((taken, -best.astype(np.float64)))[:limit]
    y, x = np.divmod(taken[order], frame.stride)
    return np.stack([x - radius, y - radius], axis=1).astype(np.int64, copy=False), best[order]


def _numbered(scores: Scores, mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """The candidates numbered in the loop's order, the highest number first: the same order without ties."""
    candidates = np.flatnonzero(mask)
    order = candidates[np.argsort(-scores.ravel()[candidates].astype(np.float64), kind="stable")]
    numbers = np.zeros(scores.shape)
    numbers.ravel()[order] = np.arange(order.size, 0, -1)
    return numbers


class _Frame:
    """The remaining candidates' scores, within a frame as wide as the radius: every window lies inside.

    What is no candidate, the frame included, is -inf, or 0 among 8-bit scores.  Pixels are flat indices into
    `values`, whose order is the raster order of the map.
    """

    def __init__(self, scores: Scores, mask: npt.NDArray[np.bool_], radius: int) -> None:
        height, width = scores.shape
        eight_bits = scores.dtype == np.uint8
        self.least: Any = 1 if eight_bits else np.finfo(np.float32).min
        self._none = 0 if eight_bits else -np.inf
        self._map = np.full((height + 2 * radius, width + 2 * radius), self._none, scores.dtype)
        cv2.copyTo(scores, mask.view(np.uint8), self._map[radius : radius + height, radius : radius + width])
        self.values, self.stride = self._map.ravel(), width + 2 * radius
        self._radius, self.side = radius, 2 * radius + 1
        # A window is the rows, cut out of `values`, that start so far from its centre.
        self._starts = np.arange(-radius, radius + 1) * self.stride - radius
        self._rows = np.lib.stride_tricks.sliding_window_view(self.values, self.side, writeable=True)

    def highest(self, remaining: npt.NDArray[np.bool_]) -> Index:
        """The pixels of `remaining`, a mask of `values`, that no other in their window exceeds."""
        window = np.ones((self.side, self.side), np.uint8)
        highest = cv2.dilate(self._map, window, borderType=cv2.BORDER_CONSTANT, borderValue=self._none)
        return np.flatnonzero(remaining & (self.values == highest.ravel()))

    def first(self, index: Index) -> Index:
        """The pixels of `index` that precede all others in their window."""
        if self._radius == 0:
            return index
        # The first maximum of a window is the one that precedes the rest.
        if self._radius > 1:
            # Most fail beside a neighbour, which is cheap to see, and on a plateau, where all are equal, all but one.
            beside = (np.arange(-1, 2)[:, None] * self.stride + np.arange(-1, 2)).ravel()
            index = index[self.values[index[:, None] + beside].argmax(axis=1) == beside.size // 2]
        kept = [np.zeros(0, np.intp)]
        for block in self._blocks(index):
            around = self._rows[block[:, None] + self._starts].reshape(block.size, -1)
            kept.append(block[around.argmax(axis=1) == around.shape[1] // 2])
        return np.concatenate(kept)

    def clear(self, index: Index) -> None:
        """Remove the candidates that the windows cover."""
        for block in self._blocks(index):
            self._rows[block[:, None] + self._starts] = self._none

    def _blocks(self, index: Index) -> Iterator[Index]:
        most = max(1, _BLOCK // self.side**2)
        return (index[start : start + most] for start in range(0, index.size, most))
