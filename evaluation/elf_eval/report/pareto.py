"""Time against quality: the page with its tables, and a picture of each metric with its front."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from elf_eval.bench.pareto import Point, Study, front

from .labels import place_labels
from .table import Table

# What is drawn unless something else is asked for, where the results have it.
METRICS = ("ms", "h_auc@3", "pose_auc@10", "epi@1")

# Every family has a marker and a grey value of its own, so that the picture can be read without colour.
_STYLES = [
    {"marker": "o", "facecolor": "#1f4e9c", "edgecolor": "#1f4e9c"},
    {"marker": "o", "facecolor": "white", "edgecolor": "#1f4e9c"},
    {"marker": "^", "facecolor": "#d9822b", "edgecolor": "#8a4b0f"},
    {"marker": "s", "facecolor": "#555555", "edgecolor": "#222222"},
    {"marker": "D", "facecolor": "#bbbbbb", "edgecolor": "#222222"},
    {"marker": "v", "facecolor": "white", "edgecolor": "#222222"},
]
# The columns of shares: those of one kind stand in one.
_COLUMNS = (
    ("rep",),
    ("ms",),
    ("mma@3",),
    ("h_auc@1", "h_auc@3", "h_auc@5"),
    ("pose_auc@5", "pose_auc@10", "pose_auc@20"),
    ("epi@1", "epi@3"),
)
# Of a metric's name before its @: in tables, and on the axis of a picture.
_NAMES = {
    "rep": ("rep", "repeatability"),
    "ms": ("ms", "matching score"),
    "mma": ("MMA", "matches within {} px of the truth"),
    "h_auc": ("H AUC", "homography AUC up to {} px"),
    "pose_auc": ("pose AUC", "pose AUC up to {} degrees"),
    "pose_right": ("pose right", "poses within {} degrees"),
    "epi_ms": ("ms by lines", "matching score by epipolar lines"),
    "epi": ("epi", "matches within {} px of their epipolar lines"),
}


def markdown(study: Study, metrics: Sequence[str], pictures: Mapping[str, str]) -> str:
    """The page: what was measured, the pictures, the table of all methods, and one by groups of scenes.

    Parameters
    ----------
    metrics : names of shares
        Whose fronts the table marks.
    pictures : mapping
        From a metric to its picture's path; empty where none is drawn.
    """
    about, machine = study.about, study.about["environment"]
    text = (
        f"Time: detection and description of {about['image']} at {about['width']}x{about['height']}, "
        f"{machine['threads']} threads, median of {about['repeats']} repetitions in one run where every repetition "
        f"runs each method once, in a process of its own ({machine['cpu']}, onnxruntime {machine['onnxruntime']}, "
        f"OpenCV {machine['opencv']}). "
        f"The ratio to {about['reference']} is the median over the repetitions' pairs, with its 95 % interval. "
        f"Quality: {about['dataset']}, {about['pairs']} pairs, at most {about['max_keypoints']} keypoints; "
        "rep, ms (the matching score), MMA and AUC in percent, per scene, then over scenes. "
        "Keypoints: the mean over images, and the least in brackets. "
        f"On the front of {' or '.join(map(_title, metrics))}: no other method is both faster and better in it."
    )
    if ratios := about.get("ratios"):
        each = ", ".join(f"{name} {ratio}" for name, ratio in ratios.items())
        text += f" Matches pass a ratio test, but for ms: {each}."
    if refined := about.get("refined"):
        text += f" Matches of {', '.join(refined)} are refined by the two images, but for ms; no time has this in it."
    parts = ["# Time and quality", about["note"], text]
    parts += [f"![Time against {_axis(metric)}]({path})" for metric, path in pictures.items()]
    parts.append(_main(study, metrics).markdown())
    if any(p.groups for p in study.points):
        parts.append(_groups(study).markdown())
    return "\n\n".join(filter(None, parts)) + "\n"


def _main(study: Study, metrics: Sequence[str]) -> Table:
    fronts = {metric: front(study.points, metric) for metric in metrics}
    usual = [metric for names in _COLUMNS for metric in names]
    columns = [names for names in _COLUMNS if set(names) & set(study.metrics())]
    columns += [(metric,) for metric in metrics if metric not in usual]
    posed = any(p.epipolar for p in study.points)
    header = ["method", "front", "time, ms", f"ratio to {study.about['reference']}", "keypoints (least)"]
    header += [" / ".join([_title(first), *(name.partition("@")[2] for name in rest)]) for first, *rest in columns]
    header += ["epi median, px"] if posed else []
    rows = []
    for p in sorted(study.points, key=lambda p: p.milliseconds.value):
        on = [_title(metric) for metric, points in fronts.items() if p in points]
        row = [p.name, ", ".join(on), _digits(p.milliseconds.value)]
        row += [f"{p.ratio.value:.2f} ({p.ratio.low:.2f} to {p.ratio.high:.2f})"]
        row += [f"{p.keypoints.mean:.0f} ({p.keypoints.least})"]
        row += [" / ".join(_percent(p.quality.get(metric)) for metric in names) for names in columns]
        rows.append(row + ([_median(p)] if posed else []))
    return Table("By time", header, rows)


def _median(point: Point) -> str:
    found = point.epipolar
    return "-" if found is None or not math.isfinite(found.value) else f"{found.value:.2f}"


def _groups(study: Study) -> Table:
    names = list(study.about["groups"])
    scenes = ["{} ({})".format(n, ", ".join(s.partition("_")[2] or s for s in study.about["groups"][n])) for n in names]
    described = [p for p in study.points if p.quality.get("ms") is not None]
    rows = [[p.name, *(_percent(p.groups[n]) for n in names)] for p in described]
    return Table("ms by group of scenes", ["method", *scenes], rows)


def draw(study: Study, metric: str, path: Path) -> None:
    """Write a picture: time (logarithmic) against a share, the front as a step line."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullLocator

    scored = {p.name: 100 * score for p in study.points if (score := p.quality.get(metric)) is not None}
    points = [p for p in study.points if p.name in scored]
    best = front(points, metric)
    figure = Figure(figsize=(8.0, 5.6), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.set_xscale("log")
    times, scores = [p.milliseconds.value for p in points], [scored[p.name] for p in points]
    axes.set_xlim(min(times) / 1.6, max(times) * 2.2)
    axes.set_ylim(max(0.0, min(scores) - 4), max(scores) + 6)
    x = np.repeat([*(p.milliseconds.value for p in best), axes.get_xlim()[1]], 2)[1:]
    y = np.repeat([scored[p.name] for p in best], 2)
    steps = axes.plot(x[:-1], y, color="#888888", linewidth=1.5, zorder=1, label="front: none is faster and better")
    for family, style in zip(dict.fromkeys(p.family for p in points), _cycle(), strict=False):
        own = [p for p in points if p.family == family]
        axes.scatter(
            [p.milliseconds.value for p in own], [scored[p.name] for p in own],
            s=64, linewidth=1.4, zorder=3, label=family, **style,
        )  # fmt: skip
    axes.set_xlabel(
        f"ms per image, {study.about['width']}x{study.about['height']}, "
        f"{study.about['environment']['threads']} threads (detection and description)"
    )
    axes.set_ylabel(f"{_axis(metric)}, % ({study.about['dataset']}, up to {study.about['max_keypoints']} keypoints)")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_locator(NullLocator())
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, which="major")
    axes.legend(frameon=False, fontsize=9, loc="lower right")
    place_labels(axes, list(zip(times, scores, strict=True)), [_label(p) for p in points], steps)
    figure.savefig(path, metadata={"Software": None})


def _cycle() -> list[dict[str, Any]]:
    return _STYLES * 3


def _title(metric: str) -> str:
    """As in tables: ``h_auc@3`` -> H AUC@3."""
    kind, at, threshold = metric.partition("@")
    return _NAMES[kind][0] + at + threshold


def _axis(metric: str) -> str:
    """In words."""
    kind, _, threshold = metric.partition("@")
    return _NAMES[kind][1].format(threshold)


def _label(point: Point) -> str:
    return f"{point.name}\n{point.keypoints.mean:.0f} keypoints"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"


def _digits(value: float) -> str:
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"
