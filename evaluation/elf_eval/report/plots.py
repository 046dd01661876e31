"""Bar plots, curves over a parameter and matching accuracy, where matplotlib is installed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from elf_eval.metrics.intervals import Estimate
from elf_eval.metrics.matching_accuracy import MMA_THRESHOLDS
from elf_eval.run.averages import having, keypoints, summarize
from elf_eval.run.results import PairResult, Results
from elf_eval.suite.suite import TableEntry

from .method_names import wrapped
from .tables import how_counted, selected

_BRACKETS = "in brackets: mean number of keypoints"
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
    draw = {"bars": _bars, "curves": _curves, "mma": _mma}[entry.plot]
    datasets, methods = selected(results, entry)
    written = []
    for dataset in datasets:
        for counts in results.protocol["counts"]:
            figure = draw(results, dataset, methods, counts)
            if figure is not None:
                slug = "".join(c if c.isalnum() else "-" for c in f"{dataset['name']}-{counts}".lower())
                path = stem.with_name(f"{stem.name}-{slug}.png")
                path.parent.mkdir(exist_ok=True)
                # No date or version inside: the same results give the same file.
                figure.savefig(path, dpi=110, metadata={"Software": None})
                written.append(path)
    return written


def _bars(results: Results, dataset: dict[str, Any], methods: list[dict[str, Any]], counts: str) -> Any:
    from matplotlib.figure import Figure

    names = [m["name"] for m in methods]
    pairs = {name: having(results.of(dataset["name"], name, counts), "rep") for name in names}
    width = max(4.0, 1.1 * len(names) + 1.5)
    figure = Figure(figsize=(width, 3.8), layout="constrained")
    axes = figure.subplots()
    for metric, colour, shift in (("rep", _REP, -0.2), ("ms", _MS, 0.2)):
        values = [summarize(pairs[name], metric) for name in names]
        if not any(values):
            continue
        place = np.array([i for i, v in enumerate(values) if v is not None])
        shown = [v for v in values if v is not None]
        axes.bar(
            place + shift,
            [100 * v.mean for v in shown],
            0.38,
            label=metric,
            color=colour,
            yerr=_errors(shown),
            capsize=3,
        )
        # At the foot: the error bars hide the middle of a bar.
        for x, value in zip(place + shift, shown, strict=True):
            axes.text(x, 1.5, f"{100 * value.mean:.1f}", ha="center", color="white", fontsize=8)
    if not axes.containers:
        return None
    labels = [f"{wrapped(name, 16, 6)}\n{_count(pairs[name])}" for name in names]
    axes.set_xticks(range(len(names)), labels, fontsize=8)
    axes.set_ylim(0, 100)
    axes.set_ylabel("%")
    extra = "95 % interval over scenes, below the names: mean number of keypoints"
    axes.set_title(_title(results, dataset, counts, extra, width), fontsize=9)
    axes.legend(frameon=False, ncols=2)
    _plain(axes)
    return figure


def _curves(results: Results, dataset: dict[str, Any], methods: list[dict[str, Any]], counts: str) -> Any:
    from matplotlib.figure import Figure

    if not dataset["parameter"]:
        return None
    figure = Figure(figsize=(11.0, 3.8), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, metric in zip(panels, ("rep", "ms"), strict=True):
        for i, method in enumerate(methods):
            pairs = results.of(dataset["name"], method["name"], counts)
            values = sorted({p.parameter for p in pairs if p.parameter is not None})
            points = [summarize([p for p in pairs if p.parameter == v], metric) for v in values]
            known = [(v, 100 * p.mean) for v, p in zip(values, points, strict=True) if p is not None]
            if known:
                axes.plot(*zip(*known, strict=True), marker=_marker(i), label=_legend(method, pairs))
        axes.set_xlabel(dataset["parameter"])
        axes.set_title(metric, fontsize=9)
        axes.set_ylim(0, 100)
        _plain(axes)
    panels[0].set_ylabel("%")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", frameon=False, fontsize=8)
    figure.suptitle(_title(results, dataset, counts, _BRACKETS, 8.5), fontsize=9)
    return figure


def _mma(results: Results, dataset: dict[str, Any], methods: list[dict[str, Any]], counts: str) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.8), layout="constrained")
    axes = figure.subplots()
    for i, method in enumerate(methods):
        pairs = results.of(dataset["name"], method["name"], counts)
        points = [summarize(pairs, f"mma@{t}") for t in MMA_THRESHOLDS]
        shown = [100 * p.mean for p in points if p is not None]
        if shown:
            axes.plot(MMA_THRESHOLDS, shown, marker=_marker(i), label=_legend(method, pairs))
    if not axes.lines:
        return None
    axes.set_xlabel("threshold (px)")
    axes.set_ylabel("mean matching accuracy (%)")
    axes.set_ylim(0, 100)
    axes.set_title(_title(results, dataset, counts, _BRACKETS, 5.0), fontsize=9)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    _plain(axes)
    return figure


def _legend(method: dict[str, Any], pairs: Sequence[PairResult]) -> str:
    return f"{wrapped(method['name'], 28, 4)} ({_count(pairs)})"


def _count(pairs: Sequence[PairResult]) -> str:
    return f"{keypoints(pairs).mean:.0f}" if pairs else "-"


def _errors(values: list[Estimate]) -> Any:
    if any(np.isnan(v.low) for v in values):
        return None
    return 100 * np.array([[v.mean - v.low for v in values], [v.high - v.mean for v in values]])


def _title(results: Results, dataset: dict[str, Any], counts: str, extra: str, width: float) -> str:
    """In lines that a figure of so many inches has room for, at 9 points."""
    text = f"{dataset['name']}, {how_counted(results, counts)}; {extra}"
    return wrapped(text, int(width * 13), 8)


def _marker(index: int) -> str:
    return "osD^vPX*<>"[index % 10]


def _plain(axes: Any) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)
