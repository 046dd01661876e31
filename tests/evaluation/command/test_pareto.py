"""`elf-eval pareto`."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import METHOD, error_of, write_suite
from scenes import write_strecha

from elf_eval.bench.pareto import Study
from elf_eval.cli import main
from elf_eval.metrics.families import SHARES
from elf_eval.report import plots
from elf_eval.report.pareto import _axis, _title, markdown


def test_pareto_names_the_method_that_is_not_here(hpatches_folder, photo_file, tmp_path, monkeypatch, capsys):
    (tmp_path / "features").mkdir()
    monkeypatch.setenv("WHERE", str(tmp_path / "gone"))
    run = write_suite(tmp_path / "s.toml", hpatches_folder, [METHOD.format("SIFT", "sift")])
    assert main(run) == 0
    write_suite(tmp_path / "s.toml", hpatches_folder, [METHOD.format("SIFT", "npz:${WHERE}")])
    where = [str(tmp_path / "s.toml"), str(tmp_path / "o" / "s" / "results.json"), "--image", str(photo_file)]
    capsys.readouterr()
    (line,) = error_of(["pareto", *where, "--out", str(tmp_path / "p")], capsys)
    gone = tmp_path / "gone"
    assert line == f"method 'SIFT': npz:{gone}: no such folder: {gone} (WHERE is {gone}, from the environment)"


def test_pareto_checks_the_picture_s_folder_before_it_times(results, tmp_path, capsys):
    where = ["pareto", "none.toml", results, "--image", "none.png", "--out", str(tmp_path / "p")]
    (line,) = error_of([*where, "--picture", str(tmp_path / "no" / "p.png")], capsys)
    assert line == f"--picture: there is no folder {tmp_path / 'no'}"


SUITE = """
[protocol]
size = [160, 120]
max_keypoints = 60
[[dataset]]
name = "two"
spec = "hpatches:{folder}"
[groups]
light = ["i_light"]
place = ["v_turn", "v_absent"]
[[method]]
name = "SIFT"
detector = "sift"
[[method]]
name = "a.b ORB"
detector = "orb"
family = "binary"
[[method]]
name = "no descriptors"
detector = "sobel?nms_radius=20"
"""


@pytest.fixture
def measured(hpatches_folder, photo_file, tmp_path):
    """A suite, its results, and the command that measures it."""
    suite = tmp_path / "s.toml"
    suite.write_text(SUITE.format(folder=hpatches_folder))
    assert main(["run", str(suite), "--out", str(tmp_path), "--cache", str(tmp_path / "c"), "--quiet"]) == 0
    results = str(tmp_path / "s" / "results.json")
    quick = ["--image", str(photo_file), "--repeats", "2", "--warmup", "1", "--threads", "1"]
    return ["pareto", str(suite), results, *quick, "--out", str(tmp_path / "new" / "p")]


def test_one_command_writes_data_page_and_picture(measured, tmp_path, capsys):
    assert main(measured) == 0
    text = (tmp_path / "new" / "p.json").read_text()
    data = json.loads(text)
    assert str(tmp_path) not in text
    assert [p["name"] for p in data["points"]] == ["SIFT", "a.b ORB", "no descriptors"]
    assert data["points"][0]["ratio"]["value"] == 1.0
    assert data["points"][2]["quality"]["ms"] is None
    assert {metric for p in data["points"] for metric in p["on_front"]} >= {"ms", "h_auc@3", "mma@1"}
    assert data["about"]["image"] == "photo.png"
    assert (data["about"]["width"], data["about"]["height"]) == (160, 120)
    page = (tmp_path / "new" / "p.md").read_text()
    assert page in capsys.readouterr().out
    assert "| light (light) | place (turn, absent) |" in page
    results = json.loads((tmp_path / "s" / "results.json").read_text())
    lit = [p["metrics"]["ms"] for p in results["pairs"] if (p["scene"], p["method"]) == ("i_light", "SIFT")]
    assert f"| SIFT | {100 * np.mean(lit):.1f} | " in page
    for name in ("p.png", "p-h_auc-3.png"):
        assert (tmp_path / "new" / name).exists() == plots.available()
        assert (f"]({name})" in page) == plots.available()
    assert "On the front of ms or H AUC@3: " in page
    assert "| rep | ms | MMA@3 | H AUC@1 / 3 / 5 |\n" in page


def test_a_redrawn_page_is_the_same(measured, tmp_path):
    assert main(measured) == 0
    page = tmp_path / "new" / "p.md"
    before = page.read_text()
    page.unlink()
    assert main([*measured, "--redraw"]) == 0
    metrics = ["ms", "h_auc@3"]
    pictures = dict(zip(metrics, ["p.png", "p-h_auc-3.png"], strict=True)) if plots.available() else {}
    assert page.read_text() == before == markdown(Study.load(tmp_path / "new" / "p.json"), metrics, pictures)


def test_any_shares_are_drawn_where_the_picture_is_asked_for(measured, tmp_path, capsys):
    (tmp_path / "images").mkdir()
    asked = ["--metrics", "h_auc@5,mma@1,rep", "--picture", str(tmp_path / "images" / "q.png")]
    assert main([*measured, *asked]) == 0
    names = ["q.png", "q-mma-1.png", "q-rep.png"] if plots.available() else []
    assert sorted(path.name for path in (tmp_path / "images").iterdir()) == sorted(names)
    page = (tmp_path / "new" / "p.md").read_text()
    assert all(f"](../images/{name})" in page for name in names)
    assert "| H AUC@1 / 3 / 5 | MMA@1 |" in page
    assert "On the front of H AUC@5 or MMA@1 or rep: " in page
    capsys.readouterr()
    for redraw in ([], ["--redraw"]):
        for metric, words in (("n1", "unknown metric 'n1'"), ("h_error", "can't be averaged"), ("epi@1", "'epi@1'")):
            (line,) = error_of([*measured, *redraw, "--metrics", metric], capsys)
            assert words in line


def test_cameras_have_columns_and_pictures_of_their_own(photo_file, tmp_path, capsys):
    write_strecha(tmp_path / "wall", depth=False)
    suite = tmp_path / "s.toml"
    text = SUITE.replace("hpatches:{folder}", f"strecha:{tmp_path / 'wall'}")
    text = text.replace("orb", "orb?ratio=0.9&refine=true")
    suite.write_text(text.partition("[groups]")[0] + text[text.index("[[method]]") :])
    assert main(["run", str(suite), "--out", str(tmp_path), "--cache", str(tmp_path / "c"), "--quiet"]) == 0
    quick = ["--image", str(photo_file), "--repeats", "2", "--warmup", "1", "--threads", "1"]
    results = str(tmp_path / "s" / "results.json")
    assert main(["pareto", str(suite), results, *quick, "--out", str(tmp_path / "p")]) == 0
    page = (tmp_path / "p.md").read_text()
    assert "| keypoints (least) | pose AUC@5 / 10 / 20 | epi@1 / 3 | epi median, px |\n" in page
    assert "Matches pass a ratio test, but for ms: a.b ORB 0.9." in page
    assert "Matches of a.b ORB are refined by the two images, but for ms; no time has this in it." in page
    assert (tmp_path / "p-epi-1.png").exists() == plots.available()


def test_every_share_has_a_name_in_tables_and_on_axes():
    assert all(_title(metric) and _axis(metric) for metric in SHARES)
    assert (_title("h_auc@3"), _axis("pose_auc@10")) == ("H AUC@3", "pose AUC up to 10 degrees")


@pytest.mark.parametrize(
    ("change", "words"),
    [(["--reference", "SURF"], "no method 'SURF'"), (["--image", "none.png"], "none.png")],
)
def test_what_can_not_be_measured_is_named(measured, capsys, change, words, tmp_path):
    assert main([*measured, *change]) == 1
    assert words in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
