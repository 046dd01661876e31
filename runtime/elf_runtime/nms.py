"""Exact greedy non-maximum suppression by rounds of local maxima."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]
Scores = npt.NDArray[np.floating]
Index = npt.NDArray[np.intp]

# Where fewer than a 64th of the pixels are left, looking around each of them is cheaper than a dilation of the map.
_DENSE = 64
# Values looked at together: few enough to stay in the cache.  The result does not depend on it.
_BLOCK = 1 << 16


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
    scores : (H, W) float32 or float64, finite
    mask : (H, W) bool
        The candidates.
    radius : int, >= 0
    limit : int, >= 0, optional
        Keep the first that many in the loop's order.

    Returns
    -------
    points : (K, 2) int64, (x, y) in the loop's order
    scores : (K,), of the dtype given, descending
    """
    frame = _Frame(scores, mask, radius)
    size = frame.values.size
    least = np.float32(np.inf) if limit == 0 else np.finfo(np.float32).min
    taken, best = np.zeros(0, np.intp), np.zeros(0, scores.dtype)
    left: Index | None = None
    while left is None or left.size:
        dense = left is None or left.size * _DENSE > size
        peaks = frame.highest(least) if dense or left is None else left
        if dense and peaks.size * frame.side**2 > 4 * size:
            points, _ = greedy_nms(_numbered(scores, mask), mask, radius, limit)
            return points, scores[points[:, 1], points[:, 0]]
        peaks = frame.first(peaks)
        taken, best = np.append(taken, peaks), np.append(best, frame.values[peaks])
        frame.clear(peaks)
        if limit is not None and best.size > limit:
            least = np.partition(best, -limit)[-limit]
        left = np.flatnonzero(frame.values >= least) if left is None else left[frame.values[left] >= least]
    order = np.lexsort((taken, -best))[:limit]
    y, x = np.divmod(taken[order], frame.stride)
    return np.stack([x - radius, y - radius], axis=1).astype(np.int64, copy=False), best[order]


def _numbered(scores: Scores, mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """The candidates' numbers in the loop's order, the first one's the highest: the same order without ties."""
    candidates = np.flatnonzero(mask)
    order = candidates[np.argsort(-scores.ravel()[candidates], kind="stable")]
    numbers = np.zeros(scores.shape)
    numbers.ravel()[order] = np.arange(order.size, 0, -1)
    return numbers


class _Frame:
    """The remaining candidates' scores, within a frame of -inf as wide as the radius: every window lies inside.

    Pixels are flat indices into `values`, whose order is the raster order of the map.
    """

    def __init__(self, scores: Scores, mask: npt.NDArray[np.bool_], radius: int) -> None:
        height, width = scores.shape
        self._map = np.full((height + 2 * radius, width + 2 * radius), -np.inf, scores.dtype)
        cv2.copyTo(scores, mask.view(np.uint8), self._map[radius : radius + height, radius : radius + width])
        self.values, self.stride = self._map.ravel(), width + 2 * radius
        self._radius, self.side = radius, 2 * radius + 1
        # A window is the rows, cut out of `values`, that start so far from its centre.
        self._starts = np.arange(-radius, radius + 1) * self.stride - radius
        self._rows = np.lib.stride_tricks.sliding_window_view(self.values, self.side, writeable=True)

    def highest(self, least: np.floating) -> Index:
        """The candidates of at least that score that none in their window exceeds."""
        window = np.ones((self.side, self.side), np.uint8)
        highest = cv2.dilate(self._map, window, borderType=cv2.BORDER_CONSTANT, borderValue=-np.inf)
        return np.flatnonzero(self._map == np.maximum(highest, least, out=highest))

    def first(self, index: Index) -> Index:
        """Those of `index` that precede all others in their window."""
        if self._radius == 0:
            return index
        # Most fail beside a neighbour, which is cheap to see, and on a plateau, where all are equal, all but one.
        for offset in (-1, -self.stride, -self.stride - 1, -self.stride + 1):
            index = index[self.values[index + offset] < self.values[index]]
            index = index[self.values[index - offset] <= self.values[index]]
        middle = self.side * self.side // 2
        kept = [np.zeros(0, np.intp)]
        for block in self._blocks(index):
            around = self._rows[block[:, None] + self._starts].reshape(block.size, -1)
            own = self.values[block, None]
            free = (around[:, :middle] < own).all(axis=1) & (around[:, middle:] <= own).all(axis=1)
            kept.append(block[free])
        return np.concatenate(kept)

    def clear(self, index: Index) -> None:
        """Take what the windows cover from the candidates."""
        for block in self._blocks(index):
            self._rows[block[:, None] + self._starts] = -np.inf

    def _blocks(self, index: Index) -> Iterator[Index]:
        most = max(1, _BLOCK // self.side**2)
        return (index[start : start + most] for start in range(0, index.size, most))
