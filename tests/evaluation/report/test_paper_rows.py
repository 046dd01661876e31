"""The paper's columns and rows beside ours, on pages of scale, rotation and 3D viewpoint."""

from __future__ import annotations

from dataclasses import replace

import pytest
from made_results import LINED, PLACED, POSED, page, pair, results

from elf_eval.command.report import with_rows
from elf_eval.report.tables import build
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite, TableEntry


def views(values, parameter, method="SIFT", row="SIFT", **protocol):
    pairs = [pair("a", v, PLACED, method=method, parameter=v) for v in values]
    return results(pairs, row, parameter, **protocol)


def strecha(scenes, metrics, row="ELF-VGG", experiment="viewpoint"):
    """Results of pairs of Strecha's scenes, as many of each as are said."""
    pairs = [
        replace(pair(scene, n, metrics, 300), first=f"{scene}/0000.jpg", second=f"{scene}/{n:04d}.jpg")
        for scene, count in scenes.items()
        for n in range(1, count + 1)
    ]
    found = results(pairs, row)
    return replace(found, datasets=[{**found.datasets[0], "paper": experiment}])


def rows_of(table):
    return {row[0]: row[1:] for row in table.rows}


def test_the_paper_s_curves_stand_below_ours():
    main, curves = build(views([1.25, 2.0], "scale"), TableEntry("All", paper="robustness"))
    assert main.header[-1] == "the paper's mean at 1.25 / 1.5 / 1.75 / 2"
    # By hand from the logs' means: (72.532 + 71.043 + 70.097 + 70.374) / 4 and (51.409 + 49.663 + 49.835 + 50.747) / 4.
    assert rows_of(main)["SIFT"][-1] == "71.0 / 50.4"
    assert rows_of(main)["LIFT"] == ["not measured", "-", "-", "-", "60.5 / 54.7"]
    assert len(main.rows) == 5
    assert curves.header == ["method", "1.25", "2"]
    assert curves.rows[0] == ["SIFT", "50.0 / 25.0 (100)", "50.0 / 25.0 (100)"]
    assert rows_of(curves)["the paper: ELF-VGG"] == ["74.9 / 69.3", "64.8 / 25.6"]
    named = ["ELF-VGG", "SIFT", "SuperPoint", "LF-Net", "LIFT"]
    assert [row[0] for row in curves.rows[1:]] == [f"the paper: {name}" for name in named]


def test_a_method_without_a_row_has_a_dash():
    found = views([10.0, 50.0], "rotation (degrees)")
    found.methods.append({"name": "ORB", "paper": None})
    main, curves = build(found, TableEntry("All"))
    assert [row[-1] for row in main.rows] == ["68.3 / 44.2", "-"]
    assert rows_of(curves)["the paper: SIFT"] == ["70.8 / 51.0", "66.5 / 41.9"]


def test_angles_that_the_paper_does_not_have(tmp_path):
    found = views([0.0, 10.0], "rotation (degrees)")
    _, curves = build(found, TableEntry("All"))
    assert rows_of(curves)["the paper: SIFT"] == ["-", "70.8 / 51.0"]
    text = page(found, tmp_path)
    assert "at 10, 50, 90, 130, 170 and 210 degrees" in text
    assert "set has 0 and 10, so the means are not of the same views" in text
    _, curves = build(views([0.0, 40.0], "rotation (degrees)"), TableEntry("All"))
    assert len(curves.rows) == 1


def test_without_a_row_of_the_paper_nothing_stands_beside(tmp_path):
    found = views([1.25, 2.0], "scale", row=None)
    main, curves = build(found, TableEntry("All"))
    assert main.header[-1] == "MMA@3"
    assert len(curves.rows) == 1
    assert "the paper" not in page(found, tmp_path).lower()


def test_the_paper_s_rows_stand_there_once():
    pairs = [pair("a", 1, PLACED, counts=c, parameter=2.0) for c in ("own", "equal")]
    found = results(pairs, "SIFT", "scale", counts=("own", "equal"))
    own, own_curves, equal, equal_curves = build(found, TableEntry("All", paper="robustness"))
    assert own.header == equal.header
    assert [len(t.rows) for t in (own, own_curves, equal, equal_curves)] == [5, 6, 1, 1]


def test_what_differs_is_said(tmp_path):
    text = page(views([1.25, 1.5, 1.75, 2.0], "scale"), tmp_path)
    for words in ("HPatches' 116 scenes", "denoising (5, 2)", "numbers are not given here", "i_objects and i_table"):
        assert words in text
    assert "LIFT's log" not in text
    assert "not of the same views" not in text
    assert "v_feast and v_wall" in page(views([10.0], "rotation (degrees)"), tmp_path)


def test_a_scene_s_images_one_by_one():
    main, images = build(strecha({"entry-P10": 3}, PLACED), TableEntry("All", paper="robustness"))
    assert main.header[-1] == "the paper's entry-P10, 9 pairs"
    assert main.rows[0][0] == "SIFT"  # joined to the paper's ELF-VGG
    assert main.rows[0][-1] == "53.4 / 29.2"
    assert "entry-P10 (3 pairs): rep / ms" in images.caption
    assert images.header == ["method", *(f"{n:04d}" for n in range(1, 10)), "mean"]
    ours = rows_of(images)["SIFT"]
    assert ours == ["50.0 / 25.0 (300)"] * 3 + ["-"] * 6 + ["50.0 / 25.0 (300)"]
    theirs = rows_of(images)["the paper: ELF-VGG"]
    assert theirs[:2] == ["73.0 / 70.0", "69.1 / 53.4"]
    assert theirs[-1] == "53.4 / 29.2"


def test_a_scene_s_caption_counts_the_pairs_with_depth():
    found = strecha({"entry-P10": 3}, PLACED)
    found.pairs[1] = replace(found.pairs[1], metrics={"n1": 300, "n2": 300, **LINED, "epi_ms": 0.4})
    *_, images = build(found, TableEntry("All"))
    assert "entry-P10 (2 of 3 pairs): rep / ms" in images.caption
    assert rows_of(images)["SIFT"][:3] == ["50.0 / 25.0 (300)", "-", "50.0 / 25.0 (300)"]


def test_only_the_first_image_s_pairs_count():
    found = strecha({"entry-P10": 2}, PLACED)
    other = replace(found.pairs[0], first="entry-P10/0001.jpg", second="entry-P10/0002.jpg", metrics={"n1": 1, "n2": 1})
    found.pairs.append(other)
    *_, images = build(found, TableEntry("All"))
    assert rows_of(images)["SIFT"][1] == "50.0 / 25.0 (300)"


def test_the_mean_of_all_pairs_where_all_scenes_are_measured():
    three = {"fountain_dense": 1, "castle_entry_dense": 1, "herzjesu_dense": 1}
    main, *images = build(strecha(three, PLACED), TableEntry("All"))
    assert main.header[-4:] == [
        "the paper's fountain-P11, 10 pairs",
        "the paper's entry-P10, 9 pairs",
        "the paper's Herz-Jesu-P8, 7 pairs",
        "the paper's 26 pairs",
    ]
    assert main.rows[0][-1] == "44.2 / 23.1"
    assert len(images) == 3
    main, *images = build(strecha({"entry-P10": 1, "castle-P19": 1}, PLACED), TableEntry("All"))
    assert main.header[-1] == "the paper's entry-P10, 9 pairs"
    assert len(images) == 1


def test_without_depth_ours_is_by_lines():
    main, images = build(strecha({"entry-P10": 2}, {**POSED, **LINED, "epi_ms": 0.4}), TableEntry("All"))
    assert "rep" not in main.header
    assert main.rows[0][-1] == "53.4 / 29.2"
    assert "ms by lines, having no depth" in images.caption
    assert images.caption.endswith("; the paper's: rep / ms by depth")
    assert rows_of(images)["SIFT"][0] == "40.0 (300)"
    assert rows_of(images)["the paper: SIFT"][0] == "57.4 / 24.4"


def test_where_some_scenes_have_depth_the_paper_s_columns_stand_by_rep():
    deep, flat = strecha({"fountain-P11": 2}, {**PLACED, **POSED}), strecha({"entry-P10": 2}, POSED)
    found = replace(deep, pairs=[*deep.pairs, *flat.pairs])
    placed, posed, *images = build(found, TableEntry("All", paper="robustness"))
    assert placed.header[-1] == "the paper's fountain-P11, 10 pairs"
    assert len(placed.rows) == 5
    assert posed.header[-1] == "inliers"
    assert len(posed.rows) == 1
    assert [len(table.rows) for table in images] == [6, 6]


def test_a_suite_says_which_experiment_older_results_are():
    found = strecha({"entry-P10": 2}, PLACED, row=None, experiment="")
    suite = Suite([MethodEntry("SIFT", "sift", paper="SIFT")], [DatasetEntry("set", "x", paper="viewpoint")])
    main, images = build(with_rows(found, suite), TableEntry("All"))
    assert main.rows[0][-1] == "45.5 / 10.3"
    assert len(images.rows) == 6


@pytest.mark.parametrize("experiment", ["image matching", "generic"])
def test_of_other_experiments_the_scenes_are_not_the_paper_s(experiment, tmp_path):
    found = strecha({"entry-P10": 2}, PLACED, experiment=experiment)
    (main,) = build(found, TableEntry("All"))
    assert ("the paper's HPatches" in main.header) == (experiment == "generic")
    assert ("The paper's columns" in page(found, tmp_path)) == (experiment == "generic")
    assert "The paper's viewpoint" not in page(found, tmp_path)
