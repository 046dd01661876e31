"""Bar plots, curves over a parameter and matching accuracy, where matplotlib is installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from elf_eval.errors import EvalError
from elf_eval.metrics.intervals import Estimate
from elf_eval.metrics.matching_accuracy import MMA_THRESHOLDS
from elf_eval.run.averages import having, keypoints, summarize
from elf_eval.run.results import PairResult, Results
from elf_eval.suite.paper_logs import CURVES, Curves, experiment
from elf_eval.suite.suite import TableEntry

from .method_names import wrapped
from .paper_rows import THE_PAPER, has_rows
from .selection import Selection, selections

_BRACKETS = "in brackets: mean number of keypoints"
_MOST_TICKS = 10  # there is room for so many angles or factors below a panel
_REP, _MS = "#4477aa", "#ee7733"  # a pair that colour-blind readers can tell apart


def available() -> bool:
    """Whether matplotlib can be imported."""
    try:
        import matplotlib
    except ImportError:
        return False
    matplotlib.use("Agg")
    return True


def plot(results: Results, entry: TableEntry, stem: Path) -> list[Path]:
    """The plots of a table's entry: ``stem-<dataset>-<counts>.png``.

    Returns
    -------
    list of Path, empty where there is nothing to plot
    """
    draw = {"bars": _bars, "curves": _curves, "mma": _mma}
    written = []
    for part in selections(results, entry):
        if entry.plot == "curves" and has_rows(part, entry):
            figure = _curves(part, _of_paper(part))
        else:
            figure = draw[entry.plot](part)
        if figure is not None:
            slug = "".join(c if c.isalnum() else "-" for c in f"{part.dataset['name']}-{part.counts}".lower())
            path = stem.with_name(f"{stem.name}-{slug}.png")
            path.parent.mkdir(exist_ok=True)
            # No date or version inside: the same results give the same file.
            figure.savefig(path, dpi=110, metadata={"Software": None})
            written.append(path)
    return written


def _bars(part: Selection) -> Any:
    pairs = {name: having(pairs, "rep") for name, pairs in part.pairs.items()}
    width = max(4.0, 1.1 * len(pairs) + 1.5)
    figure = _figure(width)
    axes = figure.subplots()
    for metric, colour, shift in (("rep", _REP, -0.2), ("ms", _MS, 0.2)):
        values = [summarize(of_method, metric) for of_method in pairs.values()]
        shown = {i + shift: v for i, v in enumerate(values) if v is not None}
        if not shown:
            continue
        heights, errors = [100 * v.mean for v in shown.values()], _errors(list(shown.values()))
        axes.bar(list(shown), heights, 0.38, label=metric, color=colour, yerr=errors, capsize=3)
        # At the foot, because the error bars hide the middle of a bar.
        for x, height in zip(shown, heights, strict=True):
            axes.text(x, 1.5, f"{height:.1f}", ha="center", color="white", fontsize=8)
    if not axes.containers:
        return None
    labels = [f"{wrapped(name, 16, 6)}\n{_count(of_method)}" for name, of_method in pairs.items()]
    axes.set_xticks(range(len(pairs)), labels, fontsize=8)
    axes.set_ylabel("%")
    extra = "95 % interval over scenes, below the names: mean number of keypoints"
    axes.set_title(_title(part, extra, width), fontsize=9)
    axes.legend(frameon=False, ncols=2)
    _percent(axes)
    return figure


def curves(results: Results, dataset: str) -> Any:
    """A dataset's curves over its parameter, the paper's dashed beside them; EvalError where it has no parameter."""
    (part, *_) = selections(results, TableEntry("curves", datasets=[dataset], plot="curves"))
    figure = _curves(part, _of_paper(part))
    if figure is None:
        raise EvalError(f"{dataset}: its pairs have no angle or scale to draw curves over")
    return figure


def _of_paper(part: Selection) -> Curves:
    return CURVES.get(experiment(part.dataset), {})


def _curves(part: Selection, theirs: Curves | None = None) -> Any:
    if not part.dataset["parameter"]:
        return None
    figure = _figure(11.0, 4.4 if theirs else 3.8)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, metric in zip(panels, ("rep", "ms"), strict=True):
        for i, (name, pairs) in enumerate(part.pairs.items()):
            points = [summarize([p for p in pairs if p.parameter == v], metric) for v in part.parameters]
            _curve(axes, i, part.parameters, points, name, pairs)
        draw_paper(axes, metric, theirs or {}, part.methods)
        axes.set_xlabel(part.dataset["parameter"])
        if len(part.parameters) <= _MOST_TICKS:
            axes.set_xticks(part.parameters, [f"{value:g}" for value in part.parameters])
        axes.set_title(metric, fontsize=9)
        _percent(axes)
    panels[0].set_ylabel("%")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", frameon=False, fontsize=8)
    figure.suptitle(_title(part, _BRACKETS, 8.5), fontsize=9)
    return figure


def _mma(part: Selection) -> Any:
    figure = _figure(7.0)
    axes = figure.subplots()
    for i, (name, pairs) in enumerate(part.pairs.items()):
        points = [summarize(pairs, f"mma@{t}") for t in MMA_THRESHOLDS]
        _curve(axes, i, MMA_THRESHOLDS, points, name, pairs)
    if not axes.lines:
        return None
    axes.set_xlabel("threshold (px)")
    axes.set_ylabel("mean matching accuracy (%)")
    axes.set_title(_title(part, _BRACKETS, 5.0), fontsize=9)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    _percent(axes)
    return figure


def _figure(width: float, height: float = 3.8) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _curve(
    axes: Any,
    index: int,
    x: Sequence[float],
    points: Sequence[Estimate | None],
    name: str,
    pairs: Sequence[PairResult],
) -> None:
    if any(points):
        label = f"{wrapped(name, 28, 4)} ({_count(pairs)})"
        draw_curve(axes, x, [None if p is None else p.mean for p in points], label, **style(index))


def draw_curve(axes: Any, x: Sequence[float], shares: Sequence[float | None], label: str, **look: Any) -> None:
    """A line through shares, in percent, with a gap where there is none."""
    heights = [np.nan if share is None else 100 * share for share in shares]
    axes.plot(x, heights, label=label, **look)


def style(index: int) -> dict[str, Any]:
    """The colour, marker and line of the method of this number: from the 11th on a colour comes with another two."""
    again, number = divmod(index, 10)
    marker = "osD^vPX*<>"[(number + 5 * again) % 10]
    return {"color": f"C{number}", "marker": marker, "linestyle": ("-", (0, (3, 1, 1, 1)))[again % 2]}


def draw_paper(
    axes: Any, metric: str, theirs: Curves, methods: Sequence[Mapping[str, Any]], size: float | None = None
) -> None:
    """Draw the paper's curves of rep or ms dashed: in the colour of our method of that row, where there is one.

    `size` is that of the markers, matplotlib's own by default.
    """
    ours = {m["paper"]: number for number, m in reversed(list(enumerate(methods))) if m["paper"]}
    free = count(len(methods))
    for row, curve in theirs.items():
        heights = [rep if metric == "rep" else ms for rep, ms in curve.values()]
        look = style(ours[row] if row in ours else next(free))
        look |= {"linestyle": "--", "linewidth": 1.0, "markerfacecolor": "none", "markersize": size}
        axes.plot(list(curve), heights, label=f"{THE_PAPER}{row}", **look)


def _count(pairs: Sequence[PairResult]) -> str:
    return f"{keypoints(pairs).mean:.0f}" if pairs else "-"


def _errors(values: Sequence[Estimate]) -> Any:
    if any(np.isnan(v.low) for v in values):
        return None
    return 100 * np.array([[v.mean - v.low for v in values], [v.high - v.mean for v in values]])


def _title(part: Selection, extra: str, width: float) -> str:
    """In lines that a figure of so many inches has room for, at 9 points."""
    return wrapped(f"{part.title}; {extra}", int(width * 13), 8)


def _percent(axes: Any) -> None:
    axes.set_ylim(0, 100)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)
