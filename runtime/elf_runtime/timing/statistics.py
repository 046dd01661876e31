"""Statistics of repeated timings: percentiles, and ratios of paired repetitions with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

RESAMPLES = 2000


@dataclass(frozen=True)
class Summary:
    """Percentiles of `count` samples, in the samples' unit."""

    count: int
    p50: float
    p95: float
    p99: float


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval."""

    value: float
    low: float
    high: float


def summary(samples: Sequence[float]) -> Summary:
    """The 50th, 95th and 99th percentile, linear between neighbours.

    With few samples the upper ones are near the maximum: p99 says something of its own from 100 samples on.

    Raises
    ------
    ValueError
        If there is no sample.
    """
    if len(samples) == 0:
        raise ValueError("no samples")
    p50, p95, p99 = np.percentile(np.asarray(samples, np.float64), (50, 95, 99))
    return Summary(len(samples), float(p50), float(p95), float(p99))


def median_interval(samples: Sequence[float], confidence: float = 0.95) -> Interval:
    """The median and its percentile-bootstrap interval (Efron, 1979), the same for the same samples.

    Raises
    ------
    ValueError
        If there is no sample, or `confidence` is not in (0, 1).
    """
    if len(samples) == 0:
        raise ValueError("no samples")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence is a number in (0, 1), not {confidence!r}")
    values: npt.NDArray[np.float64] = np.asarray(samples, np.float64)
    draws = np.random.default_rng(0).integers(0, len(values), (RESAMPLES, len(values)))
    medians = np.median(values[draws], axis=1)
    tail = (1.0 - confidence) / 2.0
    low, high = np.quantile(medians, (tail, 1.0 - tail))
    return Interval(float(np.median(values)), float(low), float(high))


def paired_ratio(first: Sequence[float], second: Sequence[float], confidence: float = 0.95) -> Interval:
    """Median of ``first[i] / second[i]``, with its interval.

    Both of a pair were measured one after the other, so that what slows the machine for a while (its clock, a
    neighbour) slows both and leaves their ratio.

    Raises
    ------
    ValueError
        If the lengths differ, there is no pair, or a sample of `second` is not above 0.
    """
    if len(first) != len(second):
        raise ValueError(f"{len(first)} and {len(second)} samples don't pair")
    if any(not value > 0.0 for value in second):
        raise ValueError("a ratio needs samples above 0")
    return median_interval([a / b for a, b in zip(first, second, strict=True)], confidence)
