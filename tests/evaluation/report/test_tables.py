"""The report's tables, page and plots: what a figure is over, how many keypoints, whose estimator, the paper's rows."""

from __future__ import annotations

import csv
import math
from itertools import pairwise

import numpy as np
import pytest

from elf_eval.errors import EvalError
from elf_eval.metrics.auc import auc, auc_trapezoids
from elf_eval.protocol import Protocol
from elf_eval.report import plots
from elf_eval.report.comparison import compare, verdict
from elf_eval.report.metrics_csv import write_csv
from elf_eval.report.page import write_report
from elf_eval.report.pictures import _title
from elf_eval.report.tables import build
from elf_eval.run.results import PairResult, Results
from elf_eval.suite import paper
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite, TableEntry

POSED = {"matches": 9, "pose_error": 3.0, "pose_inliers": 7, **{f"pose_auc@{t}": auc(3.0, t) for t in (5, 10, 20)}}
PLACED = {"rep": 0.5, "ms": 0.25, **{f"mma@{t}": 0.3 for t in range(1, 11)}}
PLANAR = {"h_error": 2.0, "h_inliers": 5, **{f"h_auc@{t}": auc(2.0, t) for t in (1, 3, 5)}}


def pair(scene, number, metrics, count=100, method="SIFT", counts="own", parameter=None):
    names = (f"{scene}/0.png", f"{scene}/{number}.png")
    return PairResult("set", scene, *names, method, counts, parameter, {"n1": count, "n2": count, **metrics})


def results(pairs, paper_row=None, parameter=None, **protocol):
    names = list(dict.fromkeys(p.method for p in pairs))
    there = {(p.scene, p.pair) for p in pairs}
    about = {"pairs": len(there), "scenes": len({s for s, _ in there}), "images": 0, "sha256": "", "spec": ""}
    return Results(
        protocol=Protocol(**protocol).to_dict(),
        methods=[{"name": name, "paper": paper_row} for name in names],
        skipped=[],
        datasets=[{"name": "set", "parameter": parameter, **about}],
        versions={},
        created="2030-01-01T00:00:00",
        pairs=pairs,
    )


@pytest.fixture
def some_with_depth():
    """One scene of two pairs has depth, with 40 keypoints an image; two scenes of three pairs have none, with 400."""
    with_depth = [pair("depth", n, {**PLACED, **POSED}, 40) for n in (1, 2)]
    return [*with_depth, *(pair(scene, n, POSED, 400) for scene in ("a", "b") for n in (1, 2, 3))]


def test_figures_of_different_pairs_are_different_tables_with_their_own_counts(some_with_depth):
    placed, posed = build(results(some_with_depth), TableEntry("All"))
    assert placed.caption == "set, up to 500 keypoints (2 of 8 pairs, 1 of 3 scenes)"
    assert placed.header == ["method", "keypoints (least)", "rep", "ms", "MMA@3"]
    assert placed.rows == [["SIFT", "40 (40)", "50.0", "25.0", "30.0"]]
    assert posed.caption == "set, up to 500 keypoints (8 pairs, 3 scenes)"
    assert posed.header[2:] == ["pose AUC@5 / 10 / 20", "the same, as SuperGlue", "inliers"]
    assert posed.rows[0][1] == "302 (40)"  # (3 x 40 + 8 x 400) / 11 images


def test_the_csv_counts_the_pairs_and_scenes_of_each_metric(some_with_depth, tmp_path):
    write_csv(results(some_with_depth), tmp_path / "t.csv")
    lines = (tmp_path / "t.csv").read_text().splitlines()
    rows = {row["metric"]: row for row in csv.DictReader(lines)}
    assert (rows["rep"]["pairs"], rows["rep"]["scenes"]) == ("2", "1")
    assert (rows["pose_auc@5"]["pairs"], rows["pose_auc@5"]["scenes"]) == ("8", "3")
    assert (rows["rep"]["low"], rows["pose_auc_superglue@5"]["low"]) == ("", "")
    assert float(rows["pose_auc_superglue@5"]["mean"]) == pytest.approx(auc_trapezoids([3.0] * 8, 5))


def test_a_comparison_counts_what_has_the_metric(some_with_depth):
    found = {c.metric: c for c in compare(results(some_with_depth), results(some_with_depth))}
    assert (found["rep"].pairs, found["rep"].units) == (2, 1)
    assert (found["pose_auc@10"].pairs, found["pose_auc@10"].units) == (8, 3)
    assert [verdict(found[metric]) for metric in ("rep", "pose_auc@10")] == ["too few to tell", "noise"]


def test_matching_accuracy_is_over_the_pairs_that_have_it(some_with_depth):
    (table,) = build(results(some_with_depth), TableEntry("MMA", plot="mma"))
    assert table.caption == "set, up to 500 keypoints (2 of 8 pairs, 1 of 3 scenes): share of the matches within"
    assert table.rows[0][:3] == ["SIFT", "40 (40)", "30.0"]


def test_a_detector_alone_on_pairs_without_depth_has_its_count():
    (table,) = build(results([pair("a", 1, {}, 70)]), TableEntry("All"))
    assert (table.header, table.rows) == (["method", "keypoints (least)"], [["SIFT", "70 (70)"]])


def page(found, tmp_path, entry=None):
    write_report(found, tmp_path, "Title", "", [entry] if entry else [], "command", [])
    return (tmp_path / "README.md").read_text()


def test_a_page_names_the_estimator_of_what_it_shows(tmp_path):
    posed = page(results([pair("a", 1, POSED)]), tmp_path / "posed")
    say = "Relative poses, through the essential matrix, from mutual nearest neighbours by OpenCV's RANSAC: 1 px, 1000 "
    assert say in posed
    assert "MAGSAC" not in posed
    planar = page(results([pair("a", 1, {**PLACED, **PLANAR})]), tmp_path / "planar")
    assert "Homographies from mutual nearest neighbours by OpenCV's USAC_MAGSAC: 3 px, 10000 " in planar
    assert "essential" not in planar
    assert all("rises in a step at each error" in text and "As SuperGlue" in text for text in (posed, planar))
    assert "AUC" not in page(results([pair("a", 1, {})]), tmp_path / "none")


def superglue_auc(errors, threshold):
    """The trapezoids of the published figures, pair by pair."""
    points, area = [(0.0, 0.0)], 0.0
    for rank, error in enumerate(sorted(errors), start=1):
        if error >= threshold:
            break
        points.append((error, rank / len(errors)))
    points.append((threshold, points[-1][1]))
    for (x0, y0), (x1, y1) in pairwise(points):
        area += (x1 - x0) * (y0 + y1) / 2
    return area / threshold


def test_auc_by_trapezoids_is_that_of_a_loop(rng):
    for size in (1, 2, 7, 50):
        errors = [*rng.uniform(0, 12, size).tolist(), math.inf]
        for threshold in (1, 5, 10):
            assert auc_trapezoids(errors, threshold) == pytest.approx(superglue_auc(errors, threshold), abs=1e-12)


def test_the_two_conventions_of_auc_by_hand():
    """Errors 2 and 12 degrees, up to 10: steps give (10 - 2) / 10 / 2, trapezoids half a triangle more."""
    assert np.mean([auc(2.0, 10), auc(12.0, 10)]) == pytest.approx(0.4)
    assert auc_trapezoids([2.0, 12.0], 10) == pytest.approx(0.4 + 2.0 * 0.5 / 2 / 10)
    assert auc_trapezoids([math.inf, 30.0], 10) == 0.0


def test_pairs_without_an_estimate_count_as_failures():
    nothing = {"matches": 4, "pose_error": None, "pose_inliers": 0, **{f"pose_auc@{t}": 0.0 for t in (5, 10, 20)}}
    pairs = [pair("a", 1, POSED), pair("a", 2, nothing)]
    (table,) = build(results(pairs), TableEntry("All"))
    wanted = " / ".join(f"{100 * auc_trapezoids([3.0, math.inf], t):.1f}" for t in (5, 10, 20))
    assert table.rows[0][table.header.index("the same, as SuperGlue")] == wanted


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


@pytest.mark.parametrize("floor", [-1, 501, 2.5])
def test_a_floor_that_is_none_is_refused(floor):
    with pytest.raises(EvalError, match="count_floor is a whole number from 0 to max_keypoints"):
        Protocol(count_floor=floor)


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


def test_a_row_that_the_paper_does_not_have_is_never_a_blank():
    assert paper.figures(None, "HPatches") == "-"
    assert paper.figures("Sift", "HPatches") == "no row 'Sift'"
    with pytest.raises(EvalError, match=r"method 'mine': the paper has no row 'Sift'; it has .*'SIFT'"):
        Suite([MethodEntry("mine", "sift", paper="Sift")], [DatasetEntry("d", "x")])
    with pytest.raises(EvalError, match=r"table 'All': paper is one of .*'generic', 'gradients'.*, not 'all'"):
        TableEntry("All", paper="all")


def texts_outside(figure):
    """Texts of a figure that reach beyond it, but for numbers at ticks, which are kept beyond an axis's ends."""
    import matplotlib.text

    figure.draw_without_rendering()
    width, height = figure.bbox.width, figure.bbox.height
    shown = [t for t in figure.findobj(matplotlib.text.Text) if any(map(str.isalpha, t.get_text()))]
    boxes = [(t.get_text(), t.get_window_extent()) for t in shown]
    return [text for text, b in boxes if b.x0 < -1 or b.y0 < -1 or b.x1 > width + 1 or b.y1 > height + 1]


@pytest.mark.parametrize("count", [1, 2, 10])
@pytest.mark.parametrize("kind", ["bars", "curves", "mma"])
def test_plots_say_how_many_keypoints_and_cut_no_title(kind, count, tmp_path, monkeypatch):
    if not plots.available():
        pytest.skip("matplotlib is not installed")
    from matplotlib.figure import Figure

    methods = [f"method {i}" for i in range(count)]
    pairs = [pair("s", n, PLACED, 217, method, "equal", parameter=float(n)) for method in methods for n in (1, 2)]
    found = results(pairs, parameter="degrees", counts=("equal",), count_floor=100)
    found.datasets[0]["name"] = "A dataset with quite a long name, as a folder's path would be"
    for i, p in enumerate(found.pairs):
        found.pairs[i] = PairResult(**{**vars(p), "dataset": found.datasets[0]["name"]})
    figures = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *a, **k: (figures.append(self), save(self, *a, **k))[1])
    plots.plot(found, TableEntry("All", plot=kind), tmp_path / "01")
    (figure,) = figures
    assert texts_outside(figure) == []
    texts = " ".join(t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text")))
    assert texts.count("217") >= count
    assert "at least 100" in " ".join(texts.split())


def test_a_match_picture_s_title_is_never_cut():
    """The last words of a long title are on a line of their own, and no line touches the right edge."""
    short, long = _title("SIFT: 5 and 5 keypoints", 324), _title("a method " * 12 + ": 5 and 5 keypoints", 324)
    assert long.shape[0] > short.shape[0]
    assert (long[:, -8:] == 255).all()
    assert (short[:, :200] < 128).any()
    assert _title("méthode ☃", 324).shape == short.shape
