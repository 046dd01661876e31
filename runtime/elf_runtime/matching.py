"""Matching of descriptors: mutual nearest neighbours, with an optional ratio test."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .errors import SettingError
from .features import Features
from .params import is_number

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]

# Rows of the first side that are compared with all of the second at once.
_BAND = 512


def match(
    first: Features | npt.NDArray[np.float32],
    second: Features | npt.NDArray[np.float32],
    ratio: float | None = None,
) -> npt.NDArray[np.int64]:
    """Mutual nearest neighbours in descriptor space (L2; ties to the lower index).

    Parameters
    ----------
    first, second : Features, or (N, D) and (M, D) float32 descriptors of unit rows
    ratio : float in (0, 1), optional
        Lowe's test from the first image's side: keep a match only where the nearest distance is below
        ``ratio`` times the second nearest.

    Returns
    -------
    (K, 2) int64
        Indices into `first` and `second`, by ascending index of `first`.

    Raises
    ------
    SettingError
        If the dimensions differ, descriptors are NaN, infinite or no numbers, or `ratio` is out of range.
    """
    a, b = _rows(first, "first"), _rows(second, "second")
    if ratio is not None and not (is_number(ratio) and 0.0 < ratio < 1.0):
        raise SettingError(f"ratio is a number in (0, 1), not {ratio!r}")
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1]:
        raise SettingError(f"descriptors of shapes {a.shape} and {b.shape} can't be compared")
    if a.shape[1] == 0 and len(a) and len(b):
        raise SettingError("these features have no descriptors: the model was exported with --desc none")
    if len(a) == 0 or len(b) == 0:
        return np.zeros((0, 2), np.int64)
    to_b, to_a, two = _nearest(a, b, second=ratio is not None and len(b) > 1)
    index = np.arange(len(a))
    keep = to_a[to_b] == index
    if two is not None and ratio is not None:
        squared = np.maximum(2.0 - 2.0 * two.astype(np.float64), 0.0)
        keep &= squared[:, 1] < ratio * ratio * squared[:, 0]
    return np.stack([index[keep], to_b[keep]], axis=1)


def _rows(side: Features | npt.ArrayLike, name: str) -> Array:
    """The descriptors of one side of a match, all finite."""
    try:
        rows = np.asarray(side.descriptors if isinstance(side, Features) else side)
    except (TypeError, ValueError) as error:
        raise SettingError(f"the {name} side is Features or an (N, D) array of descriptors: {error}") from error
    if rows.dtype.kind not in "fiu":
        raise SettingError(f"the {name} side is Features or an (N, D) array of descriptors, not of {rows.dtype}")
    with np.errstate(over="ignore"):
        rows = rows.astype(np.float32, copy=False)
    if not np.isfinite(rows).all():
        raise SettingError(f"some descriptors of the {name} side are NaN or infinite")
    return rows


def _nearest(a: Array, b: Array, second: bool) -> tuple[Index, Index, Array | None]:
    """The most similar row of `b` to each of `a`, and the other way round, of the first ones where several are.

    |a - b|^2 = 2 - 2 a.b for unit rows.  The table of all products is gone through in bands of rows: it is never whole
    in memory, and a band is low enough for maxima along its columns to be cheap.

    Returns
    -------
    to_b : (N,), to_a : (M,)
    two : (N, 2), optional
        Each row's second highest and highest product, where `second`.
    """
    to_b, to_a = np.zeros(len(a), np.int64), np.zeros(len(b), np.int64)
    best = np.full(len(b), -np.inf, np.float32)
    two = np.zeros((len(a), 2), np.float32) if second else None
    for start in range(0, len(a), _BAND):
        rows = slice(start, start + _BAND)
        products = a[rows] @ b.T
        to_b[rows] = products.argmax(axis=1)
        place = products.argmax(axis=0)
        highest = products[place, np.arange(len(b))]
        better = highest > best
        best[better], to_a[better] = highest[better], place[better] + start
        if two is not None:
            two[rows] = np.partition(products, len(b) - 2, axis=1)[:, -2:]
    return to_b, to_a, two
