"""What changed between two runs, or two methods, and whether it is more than noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from elf_eval.errors import EvalError
from elf_eval.metrics.families import check_metrics, is_share
from elf_eval.metrics.intervals import Difference, paired_difference
from elf_eval.protocol import Protocol
from elf_eval.run.averages import metrics_in, scene_means
from elf_eval.run.results import PairResult, Results

METRICS = ("rep", "ms", "mma@3", "h_auc@3", "pose_auc@10", "epi@1", "n1")


@dataclass(frozen=True)
class Comparison:
    """One metric of one dataset, on the pairs that both sides have.

    Attributes
    ----------
    pairs : int
        How many have the metric on both sides.
    units : int
        Of how many scenes, or again pairs, the difference is the mean.
    """

    dataset: str
    counts: str
    method: str
    metric: str
    pairs: int
    units: int
    difference: Difference


def compare(
    a: Results,
    b: Results,
    metrics: tuple[str, ...] | None = None,
    methods: tuple[str, str] | None = None,
    unit: str = "scene",
) -> list[Comparison]:
    """b - a, for each dataset, way of counting, method and metric.

    Parameters
    ----------
    metrics : names, optional
        By default those of `METRICS` that the results have.
    methods : (in a, in b), optional
        Two methods to hold against each other; by default every method that both have under the same name.
    unit : "scene" or "pair"
        What the interval is over.  The pairs of a scene share an image, so they are not independent, and intervals
        over pairs are too narrow.

    Raises
    ------
    EvalError
        If both have nothing in common, or nothing of one of the `metrics`; if one of them is unknown or can't be
        averaged (`check_metrics`).
    """
    check_metrics(metrics or (), metrics_in([*a.pairs, *b.pairs]), "these results have")
    found = list(_comparisons(a, b, metrics or METRICS, methods, unit))
    if not found:
        names = [sorted({p.method for p in r.pairs}) for r in (a, b)]
        raise EvalError(f"nothing to compare: the methods are {names[0]} and {names[1]}; or the pairs all differ")
    if absent := [m for m in metrics or () if m not in {c.metric for c in found}]:
        raise EvalError(f"nothing to compare by {', '.join(absent)}: no pair has it on both sides")
    return found


def _comparisons(
    a: Results, b: Results, metrics: tuple[str, ...], methods: tuple[str, str] | None, unit: str
) -> Iterator[Comparison]:
    sides = _groups(a), _groups(b)
    for (dataset, counts, method), ours in sides[0].items():
        if methods is not None and method != methods[0]:
            continue
        other = method if methods is None else methods[1]
        theirs = sides[1].get((dataset, counts, other), {})
        both = [key for key in ours if key in theirs]
        label = method if other == method else f"{other} - {method}"
        for metric in metrics:
            there = [k for k in both if _has(ours[k], metric) and _has(theirs[k], metric)]
            x, y = (_units([side[k] for k in there], metric, unit) for side in (ours, theirs))
            if x:
                yield Comparison(dataset, counts, label, metric, len(there), len(x), paired_difference(x, y))


def _has(pair: PairResult, metric: str) -> bool:
    return pair.metrics.get(metric) is not None


def _groups(results: Results) -> dict[tuple[str, str, str], dict[tuple[str, str], PairResult]]:
    groups: dict[tuple[str, str, str], dict[tuple[str, str], PairResult]] = {}
    for pair in results.pairs:
        groups.setdefault((pair.dataset, pair.counts, pair.method), {})[pair.scene, pair.pair] = pair
    return groups


def _units(pairs: list[PairResult], metric: str, unit: str) -> dict[str, float]:
    if unit == "scene":
        return scene_means(pairs, metric)
    values = {f"{p.scene} {p.pair}": p.metrics.get(metric) for p in pairs}
    return {key: value for key, value in values.items() if value is not None}


def warnings(a: Results, b: Results) -> list[str]:
    """Differences in protocol, data or versions that a reader of the comparison must know about."""
    usual = Protocol().to_dict()  # of what an older version did not write
    protocols = [usual | r.protocol for r in (a, b)]
    settings = [(key, *(protocol.get(key) for protocol in protocols)) for key in protocols[0] | protocols[1]]
    found = [f"protocol {key}: {value} -> {other}" for key, value, other in settings if value != other]
    for what in ("ratio", "refine"):
        own = [{m["name"]: m.get(what, usual[what]) for m in r.methods} for r in (a, b)]
        found += [
            f"method {name}: {what} {own[0][name]} -> {own[1][name]}"
            for name in own[0]
            if name in own[1] and own[0][name] != own[1][name]
        ]
    digests = [{d["name"]: d["sha256"] for d in r.datasets} for r in (a, b)]
    found += [
        f"dataset {name}: other images or ground truth"
        for name in digests[0].keys() & digests[1].keys()
        if digests[0][name] != digests[1][name]
    ]
    return found + [f"{k}: {v} -> {b.versions.get(k)}" for k, v in a.versions.items() if b.versions.get(k) != v]


def comparison_table(comparisons: list[Comparison]) -> str:
    """Plain text: a line for each comparison, with shares in percent."""
    lines = [
        f"{'dataset':14} {'counts':6} {'method':32} {'metric':12} {'n':>4} {'b - a':>8}  {'95 % interval':18} {'p':>6}"
    ]
    for c in comparisons:
        d, factor = c.difference, 100.0 if is_share(c.metric) else 1.0
        interval = "-" if math.isnan(d.low) else f"[{factor * d.low:+.2f}, {factor * d.high:+.2f}]"
        p = "-" if math.isnan(d.p) else f"{d.p:.3f}" if d.p >= 0.001 else "<0.001"
        lines.append(
            f"{c.dataset:14} {c.counts:6} {c.method:32} {c.metric:12} {c.units:4} {factor * d.mean:+8.2f}  "
            f"{interval:18} {p:>6}  {verdict(c)}"
        )
    return "\n".join(lines)


def verdict(c: Comparison) -> str:
    """In a word: noise, better or worse; for a count, more or fewer; "too few" where there is no interval."""
    if math.isnan(c.difference.low):
        return "too few to tell"
    if c.difference.is_noise:
        return "noise"
    up = c.difference.mean > 0
    if is_share(c.metric):
        return "better" if up else "worse"
    return "more" if up else "fewer"
