"""The columns of a main table, and the pairs that each is over."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from elf_eval.metrics.auc import auc_trapezoids
from elf_eval.metrics.epipolar import EPIPOLAR_ERROR, EPIPOLAR_THRESHOLDS
from elf_eval.metrics.homography import HOMOGRAPHY_THRESHOLDS
from elf_eval.metrics.intervals import Estimate
from elf_eval.metrics.pose import MAP_THRESHOLDS, POSE_THRESHOLDS
from elf_eval.run.averages import having, median_error, summarize
from elf_eval.run.results import PairResult

Pairs = Sequence[PairResult]


@dataclass(frozen=True)
class Column:
    """A column's title, the text of a method's cell, and the metric that a pair must have to count."""

    title: str
    metric: str
    cell: Callable[[Pairs], str]


def superglue(pairs: Pairs, error: str, thresholds: Sequence[int]) -> dict[str, float] | None:
    """AUC as SuperGlue's authors compute it, by its name in tables; None where no pair has the error."""
    errors = [p.metrics[error] for p in pairs if error in p.metrics]
    if not errors:
        return None
    found = [math.inf if e is None else e for e in errors]
    kind = error.removesuffix("_error")
    return {f"{kind}_auc_superglue@{t}": auc_trapezoids(found, t) for t in thresholds}


def percent(value: Estimate | None) -> str:
    """Mean and interval."""
    if value is None:
        return "-"
    if math.isnan(value.low):  # a single scene has no interval
        return f"{100 * value.mean:.1f}"
    return f"{100 * value.mean:.1f} [{100 * value.low:.0f}, {100 * value.high:.0f}]"


def short(value: Estimate | None) -> str:
    """The mean alone."""
    return "-" if value is None else f"{100 * value.mean:.1f}"


def _means(*metrics: str) -> Callable[[Pairs], str]:
    return lambda pairs: " / ".join(short(summarize(pairs, metric)) for metric in metrics)


def _superglue(error: str, thresholds: Sequence[int]) -> Callable[[Pairs], str]:
    def cell(pairs: Pairs) -> str:
        found = superglue(pairs, error, thresholds)
        return "-" if found is None else " / ".join(f"{100 * value:.1f}" for value in found.values())

    return cell


def _mean_precision(pairs: Pairs) -> str:
    """The challenge's mAP up to each threshold: the mean of the shares of poses below it and below those before it."""
    shares = [summarize(pairs, f"pose_right@{t}") for t in MAP_THRESHOLDS]
    means = [s.mean for s in shares if s is not None]
    if len(means) < len(shares):
        return "-"
    return " / ".join(f"{100 * sum(means[:n]) / n:.1f}" for n in range(1, len(means) + 1))


def _counts(*metrics: str) -> Callable[[Pairs], str]:
    def one(pairs: Pairs, metric: str) -> str:
        value = summarize(pairs, metric)
        return "-" if value is None else f"{value.mean:.0f}"

    return lambda pairs: " / ".join(one(pairs, metric) for metric in metrics)


def _median(error: str) -> Callable[[Pairs], str]:
    def cell(pairs: Pairs) -> str:
        found = median_error(pairs, error)
        if found is None:
            return "-"
        value = f"{found.value:.2f}" if math.isfinite(found.value) else "-"
        return value if not found.failed else f"{value} ({found.failed} of {found.pairs} pairs without)"

    return cell


def _auc(kind: str, title: str, thresholds: Sequence[int]) -> list[Column]:
    names = [f"{kind}_auc@{t}" for t in thresholds]
    at = " / ".join(map(str, thresholds))
    return [
        Column(f"{title} AUC@{at}", names[0], _means(*names)),
        Column("the same, as SuperGlue", names[0], _superglue(f"{kind}_error", thresholds)),
        Column("inliers", names[0], _counts(f"{kind}_inliers")),
    ]


_EPI = " / ".join(map(str, EPIPOLAR_THRESHOLDS))

COLUMNS = [
    Column("rep", "rep", lambda pairs: percent(summarize(pairs, "rep"))),
    Column("ms", "ms", lambda pairs: percent(summarize(pairs, "ms"))),
    Column("MMA@3", "mma@3", _means("mma@3")),
    *_auc("h", "H", HOMOGRAPHY_THRESHOLDS),
    *_auc("pose", "pose", POSE_THRESHOLDS),
    Column(f"pose mAP@{' / '.join(map(str, MAP_THRESHOLDS))}", "pose_right@5", _mean_precision),
    Column("ms by lines", "epi_ms", lambda pairs: percent(summarize(pairs, "epi_ms"))),
    Column(f"epi@{_EPI}", "epi@1", _means(*(f"epi@{t}" for t in EPIPOLAR_THRESHOLDS))),
    Column(f"right within {_EPI} px", "epi@1", _counts(*(f"epi_right@{t}" for t in EPIPOLAR_THRESHOLDS))),
    Column("epi median, px", "epi@1", _median(EPIPOLAR_ERROR)),
]


def by_pairs(found: Mapping[str, Pairs]) -> list[tuple[list[Column], set[tuple[str, str]]]]:
    """The columns that some method has a value for, grouped by the pairs that they are over.

    Parameters
    ----------
    found : mapping
        Each method's pairs.

    Returns
    -------
    list of (columns, pairs by scene and name)
        One entry without columns where no metric is there at all, as for a detector on pairs without depth.
    """
    groups: list[tuple[list[Column], set[tuple[str, str]]]] = []
    for column in COLUMNS:
        over = {(p.scene, p.pair) for pairs in found.values() for p in having(pairs, column.metric)}
        if not over:
            continue
        same = next((columns for columns, others in groups if others == over), None)
        if same is None:
            groups.append(([column], over))
        else:
            same.append(column)
    everything = {(p.scene, p.pair) for pairs in found.values() for p in pairs}
    return groups or [([], everything)]
