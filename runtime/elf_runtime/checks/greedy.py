"""Greedy one-to-one matching by increasing distance, in rounds instead of a loop over sorted pairs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Pairs = npt.NDArray[np.int64]


def greedy_matching(distance: npt.NDArray[np.float64], limit: float = np.inf) -> Pairs:
    """Match rows to columns one to one: of the pairs left, always the closest next.

    The plain loop sorts all pairs by (distance, row, column) and takes each one whose row and column are
    both free.  Here all pairs that are the best of their row and of their column are taken at once: nothing
    that comes before such a pair in the loop's order can use its row or column, so the loop takes it too;
    what is left is the same problem, smaller.  The closest pair of all is always among them, so every round
    takes some.

    Equal distances go to the lower row, then to the lower column.  Only the preference within a row and
    within a column matters for the result, so the transposed matrix gives the transposed matching, ties
    included.

    Parameters
    ----------
    distance : (N, M) float64
        NaN is never matched.
    limit : float
        Pairs farther apart than this are never matched; a pair at the limit may be.

    Returns
    -------
    (K, 2) int64
        (row, column) by ascending row.
    """
    open_pairs = np.where(distance <= limit, distance, np.inf)
    rows, columns = np.arange(distance.shape[0]), np.arange(distance.shape[1])
    taken: list[Pairs] = [np.zeros((0, 2), np.int64)]
    while open_pairs.size:
        best_column = open_pairs.argmin(axis=1)
        best_row = open_pairs.argmin(axis=0)
        here = np.arange(len(rows))
        mutual = (best_row[best_column] == here) & np.isfinite(open_pairs[here, best_column])
        if not mutual.any():
            break
        chosen = best_column[mutual]
        taken.append(np.stack([rows[mutual], columns[chosen]], axis=1))
        column_left = np.ones(len(columns), np.bool_)
        column_left[chosen] = False
        # Rows and columns without an open pair would only slow down the next rounds.
        row_left = ~mutual
        open_pairs = open_pairs[np.ix_(row_left, column_left)]
        rows, columns = rows[row_left], columns[column_left]
    pairs = np.concatenate(taken)
    return pairs[np.argsort(pairs[:, 0], kind="stable")]
