"""What users index results with: the rows that an index means, and matches as pairs of indices."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError


def rows_at(index: Any, count: int) -> npt.NDArray[np.int64]:
    """The rows, (K,), of `count` that `index` chooses: an integer, a slice, a mask, or an array or list of integers.

    Raises
    ------
    IndexError
        If it is another index, out of range, or a mask of another length.
    """
    chosen = np.atleast_1d(np.arange(count)[index])
    if chosen.ndim != 1:
        raise IndexError(f"an index is an integer, a slice, a mask or a list of integers, not {index!r}")
    return chosen


def pairs_of(matches: Any, counts: tuple[int, int] | None = None) -> npt.NDArray[np.int64]:
    """The indices, (K, 2) int64, of `Matches` or of an array of such.

    Parameters
    ----------
    matches : Matches, or (K, 2) integers
    counts : (int, int), optional
        How many features the two images have, where that is known.

    Raises
    ------
    SettingError
        If they are neither, or an index is below 0 or not below its count.
    """
    pairs = np.asarray(getattr(matches, "indices", matches))
    if pairs.size == 0:
        return np.zeros((0, 2), np.int64)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
        raise SettingError(f"matches are Matches or (K, 2) integers, not {pairs.shape} {pairs.dtype}")
    if pairs.min() < 0:
        raise SettingError("matches have indices below 0")
    if counts is not None and (pairs >= counts).any():
        most = tuple(pairs.max(axis=0).tolist())
        raise SettingError(f"matches up to {most} are not of these features, {counts[0]} and {counts[1]}")
    return pairs.astype(np.int64)
