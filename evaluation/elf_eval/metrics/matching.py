"""Matches: descriptor distances and mutual nearest neighbours."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from elf_eval.coordinates import Float
from elf_eval.errors import EvalError
from elf_runtime.checks.greedy import Pairs


def descriptor_distances(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> Float:
    """(N, M) distances: L2 for float descriptors, Hamming for packed bits (uint8).

    Raises
    ------
    EvalError
        If the two are of different kinds or lengths.
    """
    if a.shape[1] != b.shape[1] or (a.dtype == np.uint8) != (b.dtype == np.uint8):
        raise EvalError(f"descriptors {a.dtype} {a.shape} and {b.dtype} {b.shape} can't be compared")
    if a.dtype == np.uint8:
        # |a xor b| = |a| + |b| - 2 a.b over the bits: one matrix product instead of N x M x bits bytes.
        x, y = np.unpackbits(a, axis=1), np.unpackbits(b, axis=1)
        common = x.astype(np.float32) @ y.astype(np.float32).T
        return np.asarray(x.sum(1, dtype=np.int64)[:, None] + y.sum(1, dtype=np.int64) - 2.0 * common, np.float64)
    x64, y64 = a.astype(np.float64), b.astype(np.float64)
    squared = (x64**2).sum(1)[:, None] + (y64**2).sum(1) - 2.0 * (x64 @ y64.T)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def mutual_nearest(distance: Float, ratio: float | None = None) -> Pairs:
    """(K, 2) int64: rows and columns that are each other's nearest, by row; ties to the lower index.

    Parameters
    ----------
    distance : (N, M)
    ratio : float in (0, 1), optional
        Lowe's test, as in `elf_runtime.match`: keep a pair only where its distance is below `ratio` times the second
        smallest of its row.  A single column passes.
    """
    if distance.size == 0:
        return np.zeros((0, 2), np.int64)
    to_column, to_row = distance.argmin(axis=1), distance.argmin(axis=0)
    rows = np.arange(distance.shape[0])
    keep = to_row[to_column] == rows
    if ratio is not None and distance.shape[1] > 1:
        nearest = np.partition(distance, 1, axis=1)
        keep &= nearest[:, 0] < ratio * nearest[:, 1]
    return np.stack([rows[keep], to_column[keep]], axis=1)
