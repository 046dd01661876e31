"""Keypoints spread over an image: a grid of cells, each with a level and a share of its own."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from elf_runtime.params import DetectionParams

from .threshold import Array, Mask, Scores, blurred, passing

Index = npt.NDArray[np.int64]


def cells(shape: tuple[int, int], grid: tuple[int, int]) -> Iterator[tuple[slice, slice]]:
    """The cells of a map of `shape`, row by row; their sides differ by a pixel at most, and none is empty."""
    rows, columns = (_edges(side, count) for side, count in zip(shape, grid, strict=True))
    for top, bottom in pairwise(rows):
        for left, right in pairwise(columns):
            yield slice(top, bottom), slice(left, right)


def _edges(side: int, count: int) -> list[int]:
    count = min(side, count)
    return [side * i // count for i in range(count + 1)]


def passing_by_cell(saliency: Array, params: DetectionParams, allowed: Mask | None = None) -> Mask:
    """The pixels that reach the level of their cell: each cell is normalised and thresholded like an image.

    Parameters
    ----------
    saliency : (H, W) float32, >= 0
    allowed : (H, W) bool, optional

    Returns
    -------
    (H, W) bool
    """
    mask = np.zeros(saliency.shape, np.bool_)
    for cell in cells(saliency.shape, params.grid):
        inside = None if allowed is None else np.ascontiguousarray(allowed[cell])
        mask[cell] = passing(*blurred(np.ascontiguousarray(saliency[cell]), params, inside), params, inside)
    return mask


def shared_out(
    points: Index, scores: Scores, shape: tuple[int, int], grid: tuple[int, int], limit: int
) -> tuple[Index, Scores]:
    """The strongest points of each cell, up to its share of `limit`; what a cell can't fill goes to the strongest left.

    Parameters
    ----------
    points : (N, 2) int64, (x, y)
    scores : (N,), descending
    shape : (H, W)
        Of the map that the points lie in.

    Returns
    -------
    points, scores : the ones kept, at most `limit`, in their order
    """
    cell, count = cell_of(points, shape, grid)
    kept = filled_up(cell, np.full(len(points), max(1, limit // count)), limit)
    return points[kept], scores[kept]


def cell_of(points: Index, shape: tuple[int, int], grid: tuple[int, int]) -> tuple[Index, int]:
    """The number, (N,) from 0 on, of the cell that each point (x, y) of a map of `shape` lies in, and how many are."""
    count = np.array([min(side, parts) for side, parts in zip(shape, grid, strict=True)])
    # The cell of pixel p is the last that begins at or before it: side * i // count <= p.
    row, column = np.minimum((points[:, ::-1] * count + count - 1) // shape, count - 1).T
    return row * count[1] + column, int(count.prod())


def filled_up(group: Index, share: Index, limit: int) -> Index:
    """The first of each group, up to its share, and then the first of the others, up to `limit` in all.

    Parameters
    ----------
    group : (N,) int64
        Of each point, the strongest first.
    share : (N,) int64
        That of the point's group.

    Returns
    -------
    (K,) int64
        The indices of those kept, ascending.
    """
    order = np.argsort(group, kind="stable")
    starts = np.searchsorted(group[order], group[order])
    rank = np.empty(len(group), np.int64)  # 0 for the first of a group
    rank[order] = np.arange(len(group)) - starts
    return np.sort(np.argsort(rank >= share, kind="stable")[:limit])
