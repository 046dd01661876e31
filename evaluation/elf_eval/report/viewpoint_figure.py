"""The figure of 3D viewpoint: a column for each scene, over its images, with the paper's curves dashed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from elf_eval.run.averages import having, keypoints
from elf_eval.run.results import PairResult, Results
from elf_eval.suite.paper_logs import VIEWPOINT, scene_of

from .method_names import wrapped
from .paper_rows import THE_PAPER, image_number, pairs_text
from .plots import draw_curve, draw_paper, style

_METRICS = {"rep": "Repeatability (%)", "ms": "Matching score (%)"}
_BESIDE_PAPER = {
    "rep": "Repeatability (%): the paper's alone,\nours needs depth",
    "ms": "Matching score (%):\nours by epipolar lines",
}
_WITHOUT_DEPTH = {"rep": "no repeatability without depth", "ms": "Matching score by epipolar lines (%)"}


def viewpoint(results: Results, dataset: str) -> Any:
    """A column for each scene, over the second image of each pair: rep above, ms below (figure 8).

    Where there is no depth, the matching score by epipolar lines stands for ms, and there is no rep.  A line has a gap
    at a pair that was not measured.  Of Strecha's three scenes the paper's curves are dashed beside ours, in the same
    colours.
    """
    scenes = list(dict.fromkeys(p.scene for p in results.pairs if p.dataset == dataset))
    figure = _figure(4.2 * len(scenes) + 1.9, 6.4)
    panels = figure.subplots(2, len(scenes), squeeze=False)
    legend: dict[str, Any] = {}
    every = {m["name"]: results.of(dataset, m["name"], "own") for m in results.methods}
    labels = [f"{wrapped(m, 24, 3)} ({keypoints(p).mean:.0f})" if p else m for m, p in every.items()]
    drawn, there = 0, 0
    for column, scene in enumerate(scenes):
        pairs = dict(zip(labels, (_of_first(p, scene) for p in every.values()), strict=True))
        numbers = _numbers(pairs)
        drawn, there = drawn + numbers[0], there + numbers[1]
        for row, metric in enumerate(_METRICS):
            axes = panels[row][column]
            known = scene_of(scene)
            _panel(axes, metric, pairs, _BESIDE_PAPER if known else _WITHOUT_DEPTH)
            if known:
                draw_paper(axes, metric, VIEWPOINT[known], results.methods, size=4)
            axes.set_title(f"{scene}: {pairs_text(*numbers)}" if numbers[0] < numbers[1] else scene, fontsize=9)
            if places := [x for line in axes.lines for x in line.get_xdata()]:
                axes.set_xlim(min(places) - 0.5, max(places) + 0.5)
            legend |= dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    ordered = sorted(legend.items(), key=lambda item: item[0].startswith(THE_PAPER))
    figure.legend(
        [handle for _, handle in ordered],
        [label for label, _ in ordered],
        loc="outside right center",
        frameon=False,
        fontsize=8,
    )
    over = f"{pairs_text(drawn, there)} of {len(scenes)} scene{'' if len(scenes) == 1 else 's'}"
    title = f"{dataset}: {over}; in brackets: mean number of keypoints"
    figure.suptitle(wrapped(title, 45 * len(scenes), 3), fontsize=10)
    return figure


def _of_first(pairs: Sequence[PairResult], scene: str) -> list[PairResult]:
    """A scene's pairs of its first image with another."""
    found = [p for p in pairs if p.scene == scene]
    return [p for p in found if p.first == found[0].first]


def _panel(axes: Any, metric: str, pairs: dict[str, list[PairResult]], without_depth: dict[str, str]) -> None:
    """One scene's curves of one metric, by their labels; `without_depth` are the axes' labels where there is none."""
    from matplotlib.ticker import MaxNLocator

    deep = _deep(pairs)
    shown = metric if deep else "epi_ms" if metric == "ms" else ""
    for number, (label, of_method) in enumerate(pairs.items()):
        if having(of_method, shown):
            places = [_place(p, n) for n, p in enumerate(of_method, start=1)]
            draw_curve(axes, places, [p.metrics.get(shown) for p in of_method], label, **style(number), markersize=4)
    axes.set_ylim(0, 100)
    axes.set_ylabel((_METRICS if deep else without_depth)[metric], fontsize=9)
    axes.set_xlabel("image, against the first one", fontsize=8)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)


def _deep(pairs: dict[str, list[PairResult]]) -> bool:
    """Whether a scene has depth, for one of its pairs at least."""
    return any("rep" in p.metrics for of_method in pairs.values() for p in of_method)


def _numbers(pairs: dict[str, list[PairResult]]) -> tuple[int, int]:
    """How many pairs of a scene have a score that is drawn, and how many there are."""
    metric = "ms" if _deep(pairs) else "epi_ms"
    there = {p.pair for of_method in pairs.values() for p in of_method}
    return len({p.pair for of_method in pairs.values() for p in having(of_method, metric)}), len(there)


def _place(pair: PairResult, position: int) -> float:
    """Where a pair stands: at its second image's number, where the images are numbered from 0000 on."""
    number = image_number(pair)
    return float(position) if number is None else number


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")
