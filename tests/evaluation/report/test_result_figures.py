"""The paper's figures of results: what the bars and curves show."""

from __future__ import annotations

from dataclasses import replace

import pytest
from made_results import PLACED, pair, results

from elf_eval.errors import EvalError
from elf_eval.report import plots, result_figures

pytestmark = pytest.mark.skipif(not plots.available(), reason="matplotlib is not installed")


def named(found, dataset, rows):
    """The results under a dataset's name, with the paper's rows of the methods."""
    return replace(
        found,
        datasets=[{**found.datasets[0], "name": dataset}],
        methods=[{**m, "paper": rows.get(m["name"])} for m in found.methods],
        pairs=[replace(p, dataset=dataset) for p in found.pairs],
    )


def heights(axes):
    return {(round(bar.get_x() + bar.get_width() / 2, 2), round(bar.get_height(), 1)) for bar in axes.patches}


def test_bars_stand_beside_the_paper_s_own():
    found = results([pair("a", 1, PLACED, method="mine"), pair("a", 1, PLACED, method="ELF-x")])
    figure = result_figures.bars(named(found, "Webcam", {"mine": "SIFT", "ELF-x": "ELF-VGG"}), "Webcam")
    rep, ms = figure.axes
    labels = [label.get_text().replace("\n", " ") for label in ms.get_xticklabels()]
    assert labels[:1] == ["ELF-x 100"]
    assert len(labels) == 14  # all the paper's rows
    at = labels.index("mine 100")
    assert {(-0.2, 50.0), (0.2, 53.2), (at - 0.2, 50.0), (at + 0.2, 28.2)} <= heights(rep)
    assert {(-0.2, 25.0), (0.2, 43.7), (at - 0.2, 25.0), (at + 0.2, 8.3)} <= heights(ms)
    other = result_figures.bars(named(found, "Oxford", {"ELF-x": "ELF-VGG"}), "Oxford")
    assert (0.2, 63.8) in heights(other.axes[0])
    assert "the paper, HPatches" in [text.get_text() for text in other.axes[0].get_legend().get_texts()]


def test_components_are_three_of_ours_and_three_of_the_paper_s():
    rows = {"S": "SIFT", "S at": "SIFT at ELF's keypoints", "S with": "SIFT + ELF's descriptor"}
    each = [pair("a", 1, {**PLACED, "ms": 0.1 * n}, method=name) for n, name in enumerate(rows, start=2)]
    (axes,) = result_figures.components(named(results(each), "HPatches", rows), "HPatches").axes
    at = [label.get_text() for label in axes.get_xticklabels()].index("SIFT")
    found = {height for x, height in heights(axes) if abs(x - at) < 0.5}
    assert found == {20.0, 30.0, 40.0, 24.6, 50.6, 27.0}


def test_curves_need_a_parameter():
    with pytest.raises(EvalError, match="no angle or scale"):
        plots.curves(results([pair("a", 1, PLACED)]), "set")


def test_curves_have_the_paper_s_dashed_beside_them():
    pairs = [pair("a", v, PLACED, method=m, parameter=v) for m in ("ORB", "mine") for v in (1.25, 1.5)]
    found = named(results(pairs, parameter="scale"), "scale", {"mine": "SIFT"})
    rep, ms = plots.curves(found, "scale").axes
    for axes, heights in ((rep, [72.532, 71.043, 70.097, 70.374]), (ms, [51.409, 49.663, 49.835, 50.747])):
        lines = {line.get_label(): line for line in axes.lines}
        assert list(lines["the paper: SIFT"].get_xdata()) == [1.25, 1.5, 1.75, 2]
        assert list(lines["the paper: SIFT"].get_ydata()) == heights
        assert lines["the paper: SIFT"].get_color() == lines["mine (100)"].get_color()
        assert lines["the paper: SIFT"].get_linestyle() == "--"
        assert len(lines) == 7
        assert len({line.get_color() for line in lines.values()}) == 6
    other = results([pair("a", v, PLACED, parameter=v) for v in (1.0, 2.0)], parameter="blur")
    assert len(plots.curves(other, "set").axes[0].lines) == 1


def test_curves_have_their_ticks_at_the_factors():
    factors = [1.25, 1.5, 1.75, 2.0]
    pairs = [pair("a", n, PLACED, parameter=value) for n, value in enumerate(factors)]
    for axes in plots.curves(results(pairs, parameter="scale"), "set").axes:
        assert list(axes.get_xticks()) == factors
        assert [label.get_text() for label in axes.get_xticklabels()] == ["1.25", "1.5", "1.75", "2"]
    many = [pair("a", value, PLACED, parameter=float(value)) for value in range(0, 360, 10)]
    figure = plots.curves(results(many, parameter="rotation (degrees)"), "set")
    assert len(figure.axes[0].get_xticks()) < 36


def test_a_dataset_is_named_where_there_are_several():
    found = results([pair("a", 1, PLACED)])
    assert result_figures.dataset_of(found, None) == "set"
    with pytest.raises(EvalError, match=r"one of \['set'\], not 'other'"):
        result_figures.dataset_of(found, "other")
    two = replace(found, datasets=[*found.datasets, {**found.datasets[0], "name": "more"}])
    with pytest.raises(EvalError, match=r"one of \['set', 'more'\]$"):
        result_figures.dataset_of(two, None)


def test_the_bars_title_counts_the_pairs_that_they_are_over():
    found = results([pair("a", 1, PLACED), pair("a", 2, {"epi_ms": 0.4}), pair("b", 1, PLACED)])
    for draw in (result_figures.bars, result_figures.components):
        assert draw(found, "set").get_suptitle() == "set: 2 of 3 pairs of 2 scenes"


def test_a_curve_has_a_gap_where_nothing_was_measured():
    pairs = [pair("a", v, {} if v == 20.0 else PLACED, parameter=v) for v in (10.0, 20.0, 30.0)]
    rep, ms = plots.curves(results(pairs, parameter="degrees"), "set").axes
    for axes, value in ((rep, 50.0), (ms, 25.0)):
        assert list(axes.lines[0].get_xdata()) == [10.0, 20.0, 30.0]
        assert list(axes.lines[0].get_ydata()) == pytest.approx([value, float("nan"), value], nan_ok=True)
