"""Keypoints of several working scales made one: a suppression across the scales, and each scale's share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .grid import filled_up

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Candidates:
    """The keypoints of one level after its own suppression.

    Attributes
    ----------
    places : (N, 2) float32
        (x, y) in source pixels.
    scores : (N,)
    scale : float
        The level's working scale.
    cell : (N,) int64
        Number of the cell of a grid, of `cells`, that the keypoint lies in.
    """

    places: Array
    scores: npt.NDArray[np.number]
    scale: float
    cell: Index
    cells: int


def merged(levels: Sequence[Candidates], radius: int, limit: int) -> tuple[Index, Index]:
    """The keypoints that are kept of those of several levels.

    The plain loop takes all of them by descending score, ties by level and then in raster order, and lets each one
    taken suppress those of *other* levels in the square window of ``2 * radius + 1`` source pixels around it.  Of what
    is left, each level keeps its strongest up to its share of `limit`, which is in proportion to its scale, and within
    it the cells of a grid have equal parts; what is not filled goes to the strongest left over.

    Parameters
    ----------
    levels : the finest first
    radius, limit : int, >= 0

    Returns
    -------
    level, index : (K,) int64, K <= limit
        The keypoints kept, in the loop's order: the number of the level of each, and its index there.
    """
    level = np.repeat(np.arange(len(levels)), [len(one.scores) for one in levels])
    places = np.concatenate([one.places for one in levels]).astype(np.float64)
    scores = np.concatenate([one.scores for one in levels]).astype(np.float64)
    order = np.lexsort((places[:, 0], places[:, 1], level, -scores))
    left = order[_unsuppressed(places[order], level[order], radius)]
    total = sum(one.scale for one in levels)
    shares = np.array([max(1, round(limit * one.scale / total) // one.cells) for one in levels])
    group = np.concatenate([one.cell for one in levels]) + level * max(one.cells for one in levels)
    kept = left[filled_up(group[left], shares[level[left]], limit)]
    index = np.concatenate([np.arange(len(one.scores)) for one in levels])
    return level[kept], index[kept]


def _unsuppressed(places: npt.NDArray[np.float64], level: Index, radius: int) -> npt.NDArray[np.bool_]:
    """(N,): which of the keypoints, given in the loop's order, the loop takes."""
    taken = np.ones(len(places), np.bool_)
    for first, second in _conflicts(places, level, radius):
        if taken[first]:
            taken[second] = False
    return taken


def _conflicts(places: npt.NDArray[np.float64], level: Index, radius: int) -> list[list[int]]:
    """Pairs (i, j), i < j, by ascending i, of keypoints of different levels in each other's window."""
    # Whoever is in the window lies in one of nine cells of that size, of which the three of a row follow each other.
    row, column = np.floor((places[:, ::-1] - places.min(axis=0, initial=0.0)[::-1]) / (radius + 1)).astype(np.int64).T
    columns = column.max(initial=0) + 3
    cell = (row + 1) * columns + column + 1
    by_cell = np.argsort(cell, kind="stable")
    sorted_cells, pairs = cell[by_cell], []
    for below in (-1, 0, 1):
        begins = np.searchsorted(sorted_cells, cell + below * columns - 1, side="left")
        counts = np.searchsorted(sorted_cells, cell + below * columns + 1, side="right") - begins
        first = np.repeat(np.arange(len(cell)), counts)
        within = np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
        second = by_cell[np.repeat(begins, counts) + within]
        near = (np.abs(places[first] - places[second]) <= radius).all(axis=1)
        kept = near & (first < second) & (level[first] != level[second])
        pairs.append(np.stack([first[kept], second[kept]], axis=1))
    found = np.concatenate(pairs)
    conflicts: list[list[int]] = found[np.argsort(found[:, 0], kind="stable")].tolist()
    return conflicts
