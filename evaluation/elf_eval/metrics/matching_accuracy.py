"""How many matches there are, and which share of them is right."""

from __future__ import annotations

import numpy as np

from elf_eval.coordinates import Float

from .family import FeaturePair, MetricFamily, Record

MMA_THRESHOLDS = tuple(range(1, 11))  # pixels
_NAMES = tuple(f"mma@{t}" for t in MMA_THRESHOLDS)


def mean_matching_accuracy(errors: Float) -> list[float]:
    """The share of the matches within 1, 2, ..., 10 pixels.

    Parameters
    ----------
    errors : (K,) float64
        Pixels between each match's warped first point and its second; NaN (no ground truth) is left out.

    Returns
    -------
    list of 10 floats in [0, 1], all 0 where there is no match
    """
    known = errors[~np.isnan(errors)]
    if known.size == 0:
        return [0.0] * len(MMA_THRESHOLDS)
    return [float((known <= t).mean()) for t in MMA_THRESHOLDS]


def _count(pair: FeaturePair) -> Record:
    return {"matches": len(pair.matches)}


def _accuracy(pair: FeaturePair) -> Record:
    assert pair.truth.forward is not None
    p1, p2 = pair.matched_points
    errors = np.linalg.norm(pair.truth.forward(p1) - p2, axis=1)
    return dict(zip(_NAMES, mean_matching_accuracy(errors), strict=True))


MATCHES = MetricFamily(_count, counts=("matches",), descriptors=True)
MATCHING_ACCURACY = MetricFamily(_accuracy, shares=_NAMES, truth="place", descriptors=True)
