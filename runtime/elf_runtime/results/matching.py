"""Matching of descriptors: mutual nearest neighbours, with an optional ratio test."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError
from elf_runtime.values import is_number

from .features import Features
from .quantization import restored

Rows = npt.NDArray[np.floating]
Index = npt.NDArray[np.int64]

# Rows of the first side that are compared with all of the second at once.
_BAND = 512


def match(
    first: Features | npt.NDArray[np.number],
    second: Features | npt.NDArray[np.number],
    ratio: float | None = None,
) -> npt.NDArray[np.int64]:
    """Mutual nearest neighbours in descriptor space (L2; ties to the lower index).

    Parameters
    ----------
    first, second : Features, or (N, D) and (M, D) descriptors
        Floats or integers.  Rows may have any length: what counts is the distance |a - b|.  Bytes that are bits (ORB's,
        BRIEF's) are refused, because their distance is Hamming's: use ``cv2.BFMatcher(cv2.NORM_HAMMING)``.
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
        If the dimensions differ, descriptors are NaN, infinite, no numbers or no (N, D) array, or `ratio` is out of
        range.
    """
    return mutual_nearest(first, second, ratio)[0]


def mutual_nearest(
    first: Features | npt.NDArray[np.number],
    second: Features | npt.NDArray[np.number],
    ratio: float | None = None,
    distances: bool = False,
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """What `match` gives, and how far the first side's descriptors are from their two nearest of the second.

    Returns
    -------
    pairs : (K, 2) int64
    squared : (K, 2) float64
        Squared distance to the nearest and to the second nearest, infinite where there is no second; (0, 2) unless
        `distances` are asked for.
    """
    a, b = as_rows(first, "first"), as_rows(second, "second")
    if ratio is not None and not (is_number(ratio) and 0.0 < ratio < 1.0):
        raise SettingError(f"ratio is a number in (0, 1), not {ratio!r}")
    if a.shape[1] != b.shape[1] and len(a) and len(b):
        raise SettingError(f"descriptors of shapes {a.shape} and {b.shape} can't be compared")
    if a.shape[1] == 0 and len(a) and len(b):
        raise SettingError("these features have no descriptors: the model was exported with --desc none")
    if len(a) == 0 or len(b) == 0:
        return np.zeros((0, 2), np.int64), np.zeros((0, 2))
    unit = _is_unit(a) and _is_unit(b)
    kind: type[np.floating] = np.float32 if unit else np.float64
    a, b = a.astype(kind, copy=False), b.astype(kind, copy=False)
    to_b, to_a, squared = _nearest(a, b, second=distances or ratio is not None)
    index = np.arange(len(a))
    keep = to_a[to_b] == index
    if squared is not None and ratio is not None:
        keep &= squared[:, 0] < ratio * ratio * squared[:, 1]
    pairs = np.stack([index[keep], to_b[keep]], axis=1)
    return pairs, squared[keep] if squared is not None and distances else np.zeros((0, 2))


def as_rows(side: Features | npt.ArrayLike, name: str) -> Rows:
    """The descriptors of one side of a match, (N, D), all finite."""
    kind = f"the {name} side is Features or an (N, D) array of descriptors"
    if isinstance(side, Features):
        side = restored(side.descriptors) if side.descriptors.dtype == np.uint8 else side.descriptors
    try:
        rows = np.asarray(side)
    except (TypeError, ValueError) as error:
        raise SettingError(f"{kind}: {error}") from error
    if rows.dtype.kind not in "fiu":
        raise SettingError(f"{kind}, not of {rows.dtype}")
    if rows.dtype == np.uint8:
        raise SettingError(
            f"the {name} side is of uint8: bits, as ORB's, are compared by cv2.BFMatcher(cv2.NORM_HAMMING); if they "
            "are numbers, pass them as float32, and those of Features.quantized as Features"
        )
    if rows.ndim != 2:
        raise SettingError(f"{kind}, not of shape {rows.shape}: it can't be compared")
    # Numbers that float32 can't hold are compared in float64.
    rows = rows.astype(np.float32 if rows.dtype in (np.float16, np.float32) else np.float64, copy=False)
    with np.errstate(over="ignore", invalid="ignore"):
        finite = np.isfinite(rows).all() and np.isfinite(_squares(rows)).all()
    if not finite:
        raise SettingError(f"some descriptors of the {name} side are NaN, infinite or too large")
    # Transposed descriptors of unit length: 16 to 512 rows whose columns have that length.
    if 16 <= len(rows) <= 512 and rows.shape[1] and _is_unit(rows.T, 1e-3) and not _is_unit(rows, 0.1):
        raise SettingError(f"{kind}; this one of shape {rows.shape} looks like (D, N): pass its transpose")
    return rows


def _squares(rows: Rows) -> npt.NDArray[np.float64]:
    """The squared length of each row."""
    return np.asarray(np.einsum("nd,nd->n", rows, rows, dtype=np.float64))


def _is_unit(rows: Rows, tolerance: float = 1e-5) -> bool:
    return bool((np.abs(_squares(rows) - 1.0) < tolerance).all())


def _nearest(a: Rows, b: Rows, second: bool) -> tuple[Index, Index, npt.NDArray[np.float64] | None]:
    """The row of `b` nearest to each of `a`, and the other way round; the first one where several are equally near.

    |a - b|^2 = |a|^2 + |b|^2 - 2 a.b; of unit rows, which come in float32, the products alone decide.  The products are
    taken in bands of rows, so that all of them are never in memory at once, and that maxima along the columns of a band
    are cheap.

    Returns
    -------
    to_b : (N,), to_a : (M,)
    squared : (N, 2), optional
        Each row's squared distance to the nearest and the second nearest, infinite where there is none; where `second`.
    """
    unit = a.dtype == np.float32
    squares, half = (np.ones(len(a)), None) if unit else (_squares(a), _squares(b) / 2)
    to_b, to_a = np.zeros(len(a), np.int64), np.zeros(len(b), np.int64)
    best = np.full(len(b), -np.inf, a.dtype)
    two = np.full((len(a), 2), -np.inf) if second else None
    for start in range(0, len(a), _BAND):
        rows = slice(start, start + _BAND)
        products = a[rows] @ b.T
        from_b = products if unit else products - squares[rows, None] / 2
        from_a = products if half is None else products - half
        to_b[rows] = from_a.argmax(axis=1)
        place = from_b.argmax(axis=0)
        highest = from_b[place, np.arange(len(b))]
        better = highest > best
        best[better], to_a[better] = highest[better], place[better] + start
        if two is not None:
            two[rows, : len(b)] = np.partition(from_a, max(len(b) - 2, 0), axis=1)[:, :-3:-1]
    if two is None:
        return to_b, to_a, None
    return to_b, to_a, np.maximum((2.0 if unit else squares[:, None]) - 2.0 * two, 0.0)
