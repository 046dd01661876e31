"""Areas under recall curves, in the two conventions in use."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def auc(error: float, threshold: float) -> float:
    """Area under one pair's recall curve, error <= e for e in [0, threshold], as a share of the whole.

    The mean over pairs is the exact area under their empirical recall curve, so it averages over scenes like every
    other metric.  `auc_trapezoids` is the other convention.
    """
    return max(0.0, 1.0 - error / threshold)


def auc_trapezoids(errors: Sequence[float], threshold: float) -> float:
    """AUC of all pairs together, as SuperGlue's authors and most since compute it: to compare with their figures.

    Slopes join (0, 0) and the points (e_i, i / n) of the sorted errors below the threshold; behind the last of them
    the curve is level.  `auc` has steps instead, whose area is smaller by up to the order of 1 / n.

    Parameters
    ----------
    errors : (n,), n >= 1
        Infinite where nothing was found.
    """
    ordered = np.sort(np.asarray(errors, np.float64))
    below = ordered[ordered < threshold]
    x = np.concatenate([[0.0], below, [threshold]])
    recall = np.arange(len(below) + 1) / ordered.size
    y = np.append(recall, recall[-1])
    return float((np.diff(x) * (y[1:] + y[:-1]) / 2.0).sum() / threshold)
