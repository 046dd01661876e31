"""Time against matching score: the page with its tables, and the picture with the front."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from elf_eval.bench.pareto import Point, Study, front

from .labels import place_labels
from .table import Table

# Every family has a marker and a grey value of its own, so that the picture can be read without colour.
_STYLES = [
    {"marker": "o", "facecolor": "#1f4e9c", "edgecolor": "#1f4e9c"},
    {"marker": "o", "facecolor": "white", "edgecolor": "#1f4e9c"},
    {"marker": "^", "facecolor": "#d9822b", "edgecolor": "#8a4b0f"},
    {"marker": "s", "facecolor": "#555555", "edgecolor": "#222222"},
    {"marker": "D", "facecolor": "#bbbbbb", "edgecolor": "#222222"},
    {"marker": "v", "facecolor": "white", "edgecolor": "#222222"},
]


def markdown(study: Study, picture: str | None = None) -> str:
    """The page: what was measured, the picture, the table of all methods, and one by groups of scenes."""
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
        "On the front: no other method is both faster and better in ms."
    )
    parts = ["# Time and matching score", about["note"], text]
    parts += [f"![Time against matching score]({picture})"] if picture else []
    parts.append(_main(study).markdown())
    if any(p.groups for p in study.points):
        parts.append(_groups(study).markdown())
    return "\n\n".join(filter(None, parts)) + "\n"


def _main(study: Study) -> Table:
    best = front(study.points)
    header = ["method", "front", "time, ms", f"ratio to {study.about['reference']}", "keypoints (least)"]
    header += ["rep", "ms", "MMA@3", "H AUC@1 / 3 / 5"]
    rows = []
    for p in sorted(study.points, key=lambda p: p.milliseconds.value):
        auc = " / ".join(_percent(p.quality[f"h_auc@{t}"]) for t in (1, 3, 5))
        rows.append(
            [p.name, "yes" if p in best else "", _digits(p.milliseconds.value),
             f"{p.ratio.value:.2f} ({p.ratio.low:.2f} to {p.ratio.high:.2f})",
             f"{p.keypoints.mean:.0f} ({p.keypoints.least})",
             *(_percent(p.quality[metric]) for metric in ("rep", "ms", "mma@3")), auc]
        )  # fmt: skip
    return Table("By time", header, rows)


def _groups(study: Study) -> Table:
    names = list(study.about["groups"])
    scenes = ["{} ({})".format(n, ", ".join(s.partition("_")[2] or s for s in study.about["groups"][n])) for n in names]
    rows = [[p.name, *(_percent(p.groups[n]) for n in names)] for p in study.points if p.score is not None]
    return Table("ms by group of scenes", ["method", *scenes], rows)


def draw(study: Study, path: Path) -> None:
    """Write the picture: time (logarithmic) against matching score, the front as a step line."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullLocator

    points = [p for p in study.points if p.score is not None]
    best = front(points)
    figure = Figure(figsize=(8.0, 5.6), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.set_xscale("log")
    times, scores = [p.milliseconds.value for p in points], [100 * (p.score or 0.0) for p in points]
    axes.set_xlim(min(times) / 1.6, max(times) * 2.2)
    axes.set_ylim(max(0.0, min(scores) - 4), max(scores) + 6)
    x = np.repeat([*(p.milliseconds.value for p in best), axes.get_xlim()[1]], 2)[1:]
    y = np.repeat([100 * (p.score or 0.0) for p in best], 2)
    steps = axes.plot(x[:-1], y, color="#888888", linewidth=1.5, zorder=1, label="front: none is faster and better")
    for family, style in zip(dict.fromkeys(p.family for p in points), _cycle(), strict=False):
        own = [p for p in points if p.family == family]
        axes.scatter(
            [p.milliseconds.value for p in own], [100 * (p.score or 0.0) for p in own],
            s=64, linewidth=1.4, zorder=3, label=family, **style,
        )  # fmt: skip
    axes.set_xlabel(
        f"ms per image, {study.about['width']}x{study.about['height']}, "
        f"{study.about['environment']['threads']} threads (detection and description)"
    )
    axes.set_ylabel(f"matching score, % ({study.about['dataset']}, up to {study.about['max_keypoints']} keypoints)")
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


def _label(point: Point) -> str:
    return f"{point.name}\n{point.keypoints.mean:.0f} keypoints"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"


def _digits(value: float) -> str:
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"
