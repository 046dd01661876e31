"""From pairs to figures: averages per scene, then over scenes."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from elf_eval.metrics.families import ERRORS, is_share
from elf_eval.metrics.intervals import Estimate, mean_interval

from .results import PairResult


@dataclass(frozen=True)
class Keypoints:
    """How many keypoints the images have: the mean, and the least."""

    mean: float
    least: int


def image_counts(pairs: Iterable[PairResult], second: bool = False) -> dict[str, float]:
    """Number of keypoints of each image of the pairs, or of each pair's second image, by the image's name."""
    first = {} if second else {p.first: p.metrics["n1"] for p in pairs}
    found = first | {p.second: p.metrics["n2"] for p in pairs}
    return {name: count for name, count in found.items() if count is not None}


def having(pairs: Iterable[PairResult], metric: str) -> list[PairResult]:
    """The pairs that have a metric."""
    return [p for p in pairs if p.metrics.get(metric) is not None]


def scene_means(pairs: Iterable[PairResult], metric: str) -> dict[str, float]:
    """Mean of a metric per scene, over the pairs that have it."""
    values: dict[str, list[float]] = {}
    for pair in pairs:
        value = pair.metrics.get(metric)
        if value is not None:
            values.setdefault(pair.scene, []).append(value)
    return {scene: sum(v) / len(v) for scene, v in values.items()}


def summarize(pairs: Sequence[PairResult], metric: str) -> Estimate | None:
    """Mean over scenes, with its interval cut to what the metric can be; None where no pair has the metric."""
    means = scene_means(pairs, metric)
    if not means:
        return None
    found, most = mean_interval(list(means.values())), 1.0 if is_share(metric) else math.inf
    return Estimate(found.mean, *(min(max(end, 0.0), most) for end in (found.low, found.high)))


@dataclass(frozen=True)
class Median:
    """The median of an error over pairs.

    Attributes
    ----------
    value : float
        Infinite where half of the pairs or more have no error.
    pairs, failed : int
        How many pairs, and how many of them have no error because nothing was found.
    """

    value: float
    pairs: int
    failed: int


def median_error(pairs: Iterable[PairResult], error: str) -> Median | None:
    """The median of an error over all pairs together, where a failure is infinite; None where no pair has the error.

    So a method is not rewarded for pairs where it finds nothing, as it would be were they left out.
    """
    errors = [p.metrics[error] for p in pairs if error in p.metrics]
    if not errors:
        return None
    found = [math.inf if e is None else e for e in errors]
    return Median(statistics.median(found), len(errors), errors.count(None))


def keypoints(pairs: Iterable[PairResult]) -> Keypoints:
    """Over all images of the pairs, each counted once."""
    numbers = list(image_counts(pairs).values())
    return Keypoints(sum(numbers) / len(numbers), int(min(numbers)))


def metrics_in(pairs: Iterable[PairResult]) -> list[str]:
    """Names of the metrics that can be averaged, in the order of their first appearance."""
    names = dict.fromkeys(name for pair in pairs for name in pair.metrics)
    return [name for name in names if name not in ERRORS]
