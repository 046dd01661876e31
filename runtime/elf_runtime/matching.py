"""Matching of descriptors: mutual nearest neighbours, with an optional ratio test."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .errors import SettingError
from .features import Features


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
        If the dimensions differ, or `ratio` is out of range.
    """
    a = first.descriptors if isinstance(first, Features) else np.asarray(first, np.float32)
    b = second.descriptors if isinstance(second, Features) else np.asarray(second, np.float32)
    if ratio is not None and not 0.0 < ratio < 1.0:
        raise SettingError(f"ratio is a number in (0, 1), not {ratio!r}")
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1]:
        raise SettingError(f"descriptors of shapes {a.shape} and {b.shape} can't be compared")
    if a.shape[1] == 0 and len(a) and len(b):
        raise SettingError("these features have no descriptors: the model was exported with --desc none")
    if len(a) == 0 or len(b) == 0:
        return np.zeros((0, 2), np.int64)
    similarity = a @ b.T  # |a - b|^2 = 2 - 2 a.b for unit rows
    to_b, to_a = similarity.argmax(axis=1), similarity.argmax(axis=0)
    index = np.arange(len(a))
    keep = to_a[to_b] == index
    if ratio is not None and len(b) > 1:
        two = np.partition(similarity, len(b) - 2, axis=1)[:, -2:]
        squared = np.maximum(2.0 - 2.0 * two.astype(np.float64), 0.0)
        keep &= squared[:, 1] < ratio * ratio * squared[:, 0]
    return np.stack([index[keep], to_b[keep]], axis=1)
