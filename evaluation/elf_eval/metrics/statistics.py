"""From pairs to scenes to one figure, and how sure of it one can be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

RESAMPLES = 5000
LEVEL = 0.95
SEED = 0


@dataclass(frozen=True)
class Estimate:
    """A mean over scenes with its bootstrap interval; `low` and `high` are NaN for a single scene."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Difference:
    """Mean of b - a over scenes, its interval, and the two-sided bootstrap p value."""

    mean: float
    low: float
    high: float
    p: float

    @property
    def is_noise(self) -> bool:
        """Whether the interval holds 0, or can't be had."""
        return not (self.low > 0.0 or self.high < 0.0)


def auc(error: float, threshold: float) -> float:
    """Area under one pair's recall curve, error <= e for e in [0, threshold], as a share of the whole.

    The mean over pairs is the exact area under their empirical recall curve, so that it averages over scenes
    like every other metric.  (The trapezoids through the sorted errors that are also in use join the curve's
    steps by slopes; the two differ by the order of 1 / pairs.)
    """
    return max(0.0, 1.0 - error / threshold)


def bootstrap_mean(scenes: Sequence[float]) -> Estimate:
    """The mean of per-scene values and its percentile bootstrap interval over scenes.

    5000 resamples of a fixed seed, 95 %.
    """
    values = np.asarray(scenes, np.float64)
    mean = float(values.mean()) if values.size else float("nan")
    if values.size < 2:
        return Estimate(mean, float("nan"), float("nan"))
    low, high = _interval(values[_resamples(values.size)].mean(axis=1))
    return Estimate(mean, low, high)


def paired_difference(a: Mapping[str, float], b: Mapping[str, float]) -> Difference:
    """b - a over the units (scenes or pairs) that both have: the units are resampled, the pairing kept."""
    units = sorted(a.keys() & b.keys())
    delta = np.array([b[u] - a[u] for u in units])
    mean = float(delta.mean()) if delta.size else float("nan")
    if delta.size < 2:
        nan = float("nan")
        return Difference(mean, nan, nan, nan)
    means = delta[_resamples(delta.size)].mean(axis=1)
    low, high = _interval(means)
    # One is added, as for every resampling test: p can't be below what so many resamples can tell.
    rarer = min(int((means <= 0.0).sum()), int((means >= 0.0).sum()))
    return Difference(mean, low, high, min(1.0, 2.0 * (rarer + 1) / (RESAMPLES + 1)))


def _resamples(count: int) -> npt.NDArray[np.int64]:
    return np.random.default_rng(SEED).integers(0, count, (RESAMPLES, count))


def _interval(means: npt.NDArray[np.float64]) -> tuple[float, float]:
    tail = (1.0 - LEVEL) / 2.0
    low, high = np.quantile(means, [tail, 1.0 - tail])
    return float(low), float(high)
