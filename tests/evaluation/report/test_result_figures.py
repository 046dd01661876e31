"""The paper's figures of results: what the bars and curves show."""

from __future__ import annotations

from dataclasses import replace

import pytest
from made_results import LINED, PLACED, pair, results

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


def test_a_scene_without_depth_shows_its_score_by_lines():
    pairs = [pair("deep", n, PLACED) for n in (1, 2, 3)] + [pair("flat", n, {**LINED, "epi_ms": 0.4}) for n in (1, 2)]
    figure = result_figures.viewpoint(results(pairs), "set")
    (rep1, rep2, ms1, ms2) = figure.axes
    assert [axes.get_title() for axes in (rep1, rep2)] == ["deep", "flat"]
    assert list(rep1.lines[0].get_ydata()) == [50.0] * 3
    assert not rep2.lines
    assert list(ms1.lines[0].get_ydata()) == [25.0] * 3
    assert list(ms2.lines[0].get_ydata()) == [40.0] * 2
    assert "epipolar" in ms2.get_ylabel()
    assert "epipolar" not in ms1.get_ylabel()


def test_curves_need_a_parameter():
    with pytest.raises(EvalError, match="no angle or scale"):
        plots.curves(results([pair("a", 1, PLACED)]), "set")


def test_a_dataset_is_named_where_there_are_several():
    found = results([pair("a", 1, PLACED)])
    assert result_figures.dataset_of(found, None) == "set"
    with pytest.raises(EvalError, match=r"one of \['set'\], not 'other'"):
        result_figures.dataset_of(found, "other")
    two = replace(found, datasets=[*found.datasets, {**found.datasets[0], "name": "more"}])
    with pytest.raises(EvalError, match=r"one of \['set', 'more'\]$"):
        result_figures.dataset_of(two, None)
