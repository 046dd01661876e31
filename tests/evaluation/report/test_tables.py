"""The report's tables: what a figure is over, how many keypoints, and the paper's rows."""

from __future__ import annotations

import math

from made_results import LINED, PLACED, POSED, page, pair, results

from elf_eval.metrics.auc import auc_trapezoids
from elf_eval.report.tables import build
from elf_eval.run.results import PairResult
from elf_eval.suite.suite import TableEntry


def test_figures_of_different_pairs_are_different_tables_with_their_own_counts(some_with_depth):
    placed, posed = build(results(some_with_depth), TableEntry("All"))
    assert placed.caption == "set, up to 500 keypoints (2 of 8 pairs, 1 of 3 scenes)"
    assert placed.header == ["method", "keypoints (least)", "rep", "ms", "MMA@3"]
    assert placed.rows == [["SIFT", "40 (40)", "50.0", "25.0", "30.0"]]
    assert posed.caption == "set, up to 500 keypoints (8 pairs, 3 scenes)"
    assert posed.header[2:] == ["pose AUC@5 / 10 / 20", "the same, as SuperGlue", "inliers"]
    assert posed.rows[0][1] == "302 (40)"  # (3 x 40 + 8 x 400) / 11 images


def test_matching_accuracy_is_over_the_pairs_that_have_it(some_with_depth):
    (table,) = build(results(some_with_depth), TableEntry("MMA", plot="mma"))
    assert table.caption == "set, up to 500 keypoints (2 of 8 pairs, 1 of 3 scenes): share of the matches within"
    assert table.rows[0][:3] == ["SIFT", "40 (40)", "30.0"]


def test_a_detector_alone_on_pairs_without_depth_has_its_count():
    (table,) = build(results([pair("a", 1, {}, 70)]), TableEntry("All"))
    assert (table.header, table.rows) == (["method", "keypoints (least)"], [["SIFT", "70 (70)"]])


def test_pairs_without_an_estimate_count_as_failures():
    nothing = {"matches": 4, "pose_error": None, "pose_inliers": 0, **{f"pose_auc@{t}": 0.0 for t in (5, 10, 20)}}
    pairs = [pair("a", 1, POSED), pair("a", 2, nothing)]
    (table,) = build(results(pairs), TableEntry("All"))
    wanted = " / ".join(f"{100 * auc_trapezoids([3.0, math.inf], t):.1f}" for t in (5, 10, 20))
    assert table.rows[0][table.header.index("the same, as SuperGlue")] == wanted


def test_the_columns_of_epipolar_lines():
    nothing = {"epi_right@1": 0, "epi_right@3": 0, "epi@1": 0.0, "epi@3": 0.0, "epi_median": None}
    better = {**LINED, "epi_right@1": 9, "epi_median": 0.125}
    (table,) = build(results([pair("a", 1, LINED), pair("a", 2, better), pair("b", 1, nothing)]), TableEntry("All"))
    assert table.header[2:] == ["epi@1 / 3", "right within 1 / 3 px", "epi median, px"]
    assert table.rows[0][2:] == ["30.0 / 40.0", "4 / 4", "0.25 (1 of 3 pairs without)"]
    (table,) = build(results([pair("a", 1, LINED), pair("b", 1, nothing)]), TableEntry("All"))
    assert table.rows[0][-1] == "- (1 of 2 pairs without)"
    (table,) = build(results([pair("a", 1, LINED), pair("b", 1, better)]), TableEntry("All"))
    assert table.rows[0][-1] == "0.19"


def test_tables_by_parameter_have_the_views_counts():
    pairs = [
        PairResult("set", "s", "0.png", f"{v}.png", "SIFT", "own", v, {"n1": 500, "n2": n, **PLACED})
        for v, n in ((10.0, 480), (50.0, 320))
    ]
    _, table = build(results(pairs, parameter="degrees"), TableEntry("All"))
    assert table.header == ["method", "10", "50"]
    assert table.rows == [["SIFT", "50.0 / 25.0 (480)", "50.0 / 25.0 (320)"]]


def test_an_equal_count_with_a_floor_says_so(tmp_path):
    pairs = [
        pair("a", n, PLACED, count, method, "equal")
        for method, counted in (("many", (100, 100)), ("few", (100, 7)))
        for n, count in enumerate(counted, start=1)
    ]
    found = results(pairs, counts=("equal",), count_floor=100)
    (table,) = build(found, TableEntry("All"))
    # 0.png is seen with 100 by the one method and, last, with 7 by the other
    assert table.caption.startswith("set, equal counts, at least 100 (2 pairs, 1 scene)")
    assert table.caption.endswith("; on 2 of 3 images a method finds fewer than 100")
    assert "but at least 100: a method that found fewer than 100 keeps what it found" in page(found, tmp_path)


def test_the_paper_s_other_rows_stand_below_ours():
    (table,) = build(results([pair("a", 1, PLACED)], "SIFT"), TableEntry("All", paper="generic"))
    rows = {row[0]: row for row in table.rows}
    assert len(table.rows) == 14
    assert rows["SIFT"][-2:] == ["51.2 / 24.6", "28.2 / 8.3"]
    assert rows["LIFT"][1:] == ["not measured", "-", "-", "-", "54.7 / 34.0", "42.2 / 17.8"]
    assert {"SURF", "ORB", "KAZE", "MSER", "TILDE", "SuperPoint", "LF-Net", "ELF-VGG"} <= rows.keys()
    (table,) = build(results([pair("a", 1, PLACED)], "Sobel"), TableEntry("All", paper="gradients"))
    rows = {row[0]: row for row in table.rows}
    assert rows["SIFT"][-2:] == ["not given", "not given"]
    assert rows["Laplacian"][-2:] == ["65.5 / 55.3", "not given"]


def test_the_paper_s_other_rows_stand_there_once():
    pairs = [pair("a", 1, PLACED, counts=counts) for counts in ("own", "equal")]
    own, equal = build(results(pairs, "SIFT", counts=("own", "equal")), TableEntry("All", paper="generic"))
    assert (len(own.rows), len(equal.rows)) == (14, 1)
    assert own.header == equal.header


def test_the_challenge_s_map_is_the_mean_of_the_shares_up_to_each_threshold():
    errors = (3.0, 12.0, 12.0, math.inf)
    pairs = [
        pair("a", n, {**POSED, **{f"pose_right@{t}": float(e < t) for t in (5, 10, 15, 20, 25)}})
        for n, e in enumerate(errors, start=1)
    ]
    (table,) = build(results(pairs), TableEntry("All"))
    cell = table.rows[0][table.header.index("pose mAP@5 / 10 / 15 / 20 / 25")]
    # 1/4, then 1/4, then 3/4 three times; the mAP up to 15 is (1/4 + 1/4 + 3/4) / 3.
    assert cell == "25.0 / 25.0 / 41.7 / 50.0 / 55.0"
