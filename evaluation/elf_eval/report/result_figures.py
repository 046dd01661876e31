"""Figures of results in the paper's form: bars beside the paper's, and components in threes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from elf_eval.errors import EvalError
from elf_eval.run.averages import having, keypoints, summarize
from elf_eval.run.results import PairResult, Results
from elf_eval.suite.paper import DATASETS, PAPER, TABLES

from .method_names import wrapped
from .paper_rows import pairs_text

_OURS, _THEIRS = "#4477aa", "#bbbbbb"
_METRICS = {"rep": "Repeatability (%)", "ms": "Matching score (%)"}
_KEYPOINTS, _DESCRIPTOR = " at ELF's keypoints", " + ELF's descriptor"


def bars(results: Results, dataset: str) -> Any:
    """Repeatability and matching score of each method beside the paper's own; ELF's variants first (figure 5)."""
    rows, known = _rows(results, dataset), _known(dataset)
    figure = _figure(max(7.0, 0.95 * len(rows) + 2.0), 6.6)
    for axes, (index, metric) in zip(figure.subplots(2, 1, sharex=True), enumerate(_METRICS), strict=True):
        for x, (pairs, row) in enumerate(rows.values()):
            ours = summarize(pairs, metric)
            theirs = PAPER[row].get(known, (None, None))[index] if row else None
            if ours is not None:
                axes.bar(x - 0.2, 100 * ours.mean, 0.38, color=_OURS, label="measured here")
                axes.text(x - 0.2, 100 * ours.mean + 1, f"{100 * ours.mean:.1f}", ha="center", fontsize=7)
            if theirs is not None:
                axes.bar(x + 0.2, theirs, 0.38, color=_THEIRS, hatch="//", label=f"the paper, {known}")
                axes.text(x + 0.2, theirs + 1, f"{theirs:.1f}", ha="center", fontsize=7)
        _percent(axes, _METRICS[metric])
        _legend(axes)
    axes.set_xlim(-0.7, len(rows) - 0.3)
    names = [wrapped(f"{name}\n{_count(pairs)}", 14, 5) for name, (pairs, _) in rows.items()]
    axes.set_xticks(range(len(rows)), names, fontsize=7)
    axes.set_xlabel("below the names: mean number of keypoints, of those measured here", fontsize=8)
    figure.suptitle(_title(results, dataset, "rep"), fontsize=10)
    return figure


def _rows(results: Results, dataset: str) -> dict[str, tuple[list[PairResult], str | None]]:
    """Methods that have been measured, and the rows of the paper that no method has; ELF's variants first."""
    rows = {
        m["name"]: (having(results.of(dataset, m["name"], "own"), "rep"), m["paper"])
        for m in results.methods
    }  # fmt: skip
    taken = {row for _, row in rows.values()}
    rows |= {row: ([], row) for row in TABLES["generic"] if row not in taken}
    return dict(sorted(rows.items(), key=lambda item: not item[0].startswith("ELF")))


def components(results: Results, dataset: str) -> Any:
    """Matching scores of methods by themselves, at ELF's keypoints, with ELF's descriptor; the paper's are hatched."""
    by_row = {m["paper"]: m["name"] for m in results.methods if m["paper"]}
    names = [row.removesuffix(_DESCRIPTOR) for row in TABLES["ELF's descriptor"] if row.endswith(_DESCRIPTOR)]
    groups = ("", _KEYPOINTS, _DESCRIPTOR)
    figure = _figure(12.0, 4.6)
    axes = figure.subplots()
    colours = ("#4477aa", "#ee7733", "#228833")
    for x, name in enumerate(names):
        for number, (ending, colour) in enumerate(zip(groups, colours, strict=True)):
            row, place = name + ending, x + 0.29 * (number - 1)
            method = by_row.get(row)
            ours = summarize(results.of(dataset, method, "own"), "ms") if method else None
            label = ("by itself", "at ELF's keypoints", "with ELF's descriptor")[number]
            here = None if ours is None else 100 * ours.mean
            for shift, value, hatch in ((-0.065, here, ""), (0.065, _ms(row, _known(dataset)), "//")):
                if value is not None:
                    axes.bar(place + shift, value, 0.13, color=colour, alpha=0.45 if hatch else 1.0, hatch=hatch,
                             label=f"{label}{f', the paper, {_known(dataset)}' if hatch else ''}")  # fmt: skip
                    axes.text(place + shift, value + 1, f"{value:.1f}", ha="center", fontsize=6, rotation=90)
    axes.set_xticks(range(len(names)), names, fontsize=9)
    axes.set_xlim(-0.6, len(names) - 0.4)
    _percent(axes, _METRICS["ms"])
    _legend(axes)
    figure.suptitle(_title(results, dataset, "ms"), fontsize=10)
    return figure


def _ms(row: str, dataset: str) -> float | None:
    figures = PAPER.get(row, {}).get(dataset)
    return figures[1] if figures else None


def _known(dataset: str) -> str:
    """Which of the paper's datasets stands beside: the same, or else HPatches, for orientation."""
    return dataset if dataset in DATASETS else DATASETS[0]


def dataset_of(results: Results, name: str | None) -> str:
    """The dataset of this name, or the only one.

    Raises
    ------
    EvalError
        If there is no such dataset, or several to choose from.
    """
    names = [d["name"] for d in results.datasets]
    if name is None and len(names) == 1:
        return str(names[0])
    if name not in names:
        raise EvalError(f"say --dataset: one of {names}" + (f", not {name!r}" if name else ""))
    return str(name)


def _title(results: Results, dataset: str, metric: str) -> str:
    """The dataset, with its numbers of pairs and scenes, and of those pairs that have the metric."""
    about = next(d for d in results.datasets if d["name"] == dataset)
    found = having((p for p in results.pairs if p.dataset == dataset), metric)
    pairs = pairs_text(len({p.pair for p in found}), about["pairs"])
    return f"{dataset}: {pairs} of {about['scenes']} scene{'' if about['scenes'] == 1 else 's'}"


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _legend(axes: Any) -> None:
    """Each label once."""
    handles, labels = axes.get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    axes.legend(once.values(), once.keys(), frameon=False, fontsize=8, ncols=3, loc="upper right")


def _percent(axes: Any, label: str) -> None:
    axes.set_ylim(0, 100)
    axes.set_ylabel(label, fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)


def _count(pairs: Sequence[PairResult]) -> str:
    return f"{keypoints(pairs).mean:.0f}" if pairs else "-"
