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
    count = np.array([min(side, parts) for side, parts in zip(shape, grid, strict=True)])
    # The cell of pixel p is the last that begins at or before it: side * i // count <= p.
    row, column = np.minimum((points[:, ::-1] * count + count - 1) // shape, count - 1).T
    cell = row * count[1] + column
    order = np.argsort(cell, kind="stable")
    starts = np.searchsorted(cell[order], cell[order])
    rank = np.empty(len(points), np.int64)  # 0 for the strongest of a cell
    rank[order] = np.arange(len(points)) - starts
    within = rank < max(1, limit // int(count.prod()))
    kept = np.sort(np.argsort(~within, kind="stable")[:limit])
    return points[kept], scores[kept]
