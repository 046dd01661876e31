"""The figure of 3D viewpoint: our curves, and the paper's dashed beside them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from made_results import LINED, PLACED, pair, results

from elf_eval.report import plots
from elf_eval.report.viewpoint_figure import viewpoint

pytestmark = pytest.mark.skipif(not plots.available(), reason="matplotlib is not installed")


def entry(metrics, numbers, method="SIFT", first=0):
    """Pairs of entry-P10: its first image against those of these numbers."""
    return [
        replace(
            pair("entry-P10", n, metrics, 300, method), first=f"entry-P10/{first:04d}.jpg",
            second=f"entry-P10/{n:04d}.jpg",
        )
        for n in numbers
    ]  # fmt: skip


def labels(figure):
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_a_scene_without_depth_shows_its_score_by_lines():
    pairs = [pair("deep", n, PLACED) for n in (1, 2, 3)] + [pair("flat", n, {**LINED, "epi_ms": 0.4}) for n in (1, 2)]
    figure = viewpoint(results(pairs), "set")
    (rep1, rep2, ms1, ms2) = figure.axes
    assert [axes.get_title() for axes in (rep1, rep2)] == ["deep", "flat"]
    assert list(rep1.lines[0].get_ydata()) == [50.0] * 3
    assert not rep2.lines
    assert list(ms1.lines[0].get_ydata()) == [25.0] * 3
    assert list(ms2.lines[0].get_ydata()) == [40.0] * 2
    assert "epipolar" in ms2.get_ylabel()
    assert "epipolar" not in ms1.get_ylabel()


def test_the_paper_s_curves_are_dashed_in_the_colour_of_ours():
    found = results([*entry(PLACED, (1, 2, 4), "ORB"), *entry(PLACED, (1, 2, 4), "mine")])
    found = replace(found, methods=[{"name": "ORB", "paper": None}, {"name": "mine", "paper": "ELF-VGG"}])
    figure = viewpoint(found, "set")
    for axes, shown, first in zip(figure.axes, (50.0, 25.0), ([73.0, 69.1], [70.0, 53.4]), strict=True):
        lines = {line.get_label(): line for line in axes.lines}
        assert list(lines["mine (300)"].get_xdata()) == [1, 2, 4]  # at the images' own numbers
        assert set(lines["mine (300)"].get_ydata()) == {shown}
        theirs = lines["the paper: ELF-VGG"]
        assert list(theirs.get_xdata()) == list(range(1, 10))
        assert list(theirs.get_ydata())[:2] == first
        assert theirs.get_linestyle() == "--"
        assert theirs.get_color() == lines["mine (300)"].get_color()
        assert len({line.get_color() for line in lines.values()}) == len(lines) - 1 == 6
        assert all(tick == int(tick) for tick in axes.get_xticks())
    assert labels(figure) == ["ORB (300)", "mine (300)", *(f"the paper: {r}" for r in
                              ("ELF-VGG", "SIFT", "SuperPoint", "LF-Net", "LIFT"))]  # fmt: skip


def test_without_depth_the_paper_s_repeatability_stands_alone():
    figure = viewpoint(results(entry({**LINED, "epi_ms": 0.4}, (1, 2))), "set")
    rep, ms = figure.axes
    assert "the paper's alone" in rep.get_ylabel()
    assert "ours by epipolar lines" in ms.get_ylabel()
    assert len(rep.lines) == 5
    assert len(ms.lines) == 6
    assert labels(figure)[0] == "SIFT (300)"  # ours before the paper's


def test_pairs_of_other_images_are_not_in_the_curve():
    found = results([*entry(PLACED, (1, 2)), *entry({**PLACED, "rep": 0.9}, (2,), first=1)])
    rep, _ = viewpoint(found, "set").axes
    assert list(rep.lines[0].get_ydata()) == [50.0, 50.0]


def test_of_several_scenes_each_method_has_one_label():
    found = results([pair("a", 1, PLACED, 100), pair("a", 2, PLACED, 100), pair("b", 1, PLACED, 400)])
    figure = viewpoint(found, "set")
    assert labels(figure) == ["SIFT (220)"]  # 3 images of 100 and 2 of 400
    assert all(tick == int(tick) for axes in figure.axes for tick in axes.get_xticks())


def test_where_there_is_no_depth_the_line_has_a_gap_and_the_pair_does_not_count():
    shallow = {**LINED, "epi_ms": 0.4}
    found = results([*entry(PLACED, (1, 2)), *entry(shallow, (3,)), *entry(PLACED, (4,)), pair("b", 1, PLACED)])
    figure = viewpoint(found, "set")
    for axes, value in ((figure.axes[0], 50.0), (figure.axes[2], 25.0)):
        (ours,) = (line for line in axes.lines if line.get_label().startswith("SIFT"))
        assert list(ours.get_xdata()) == [1, 2, 3, 4]
        assert list(ours.get_ydata()) == pytest.approx([value, value, float("nan"), value], nan_ok=True)
    assert figure.axes[0].get_title() == "entry-P10: 3 of 4 pairs"
    assert figure.axes[1].get_title() == "b"
    assert "set: 4 of 5 pairs of 2 scenes;" in " ".join(figure.get_suptitle().split())
