"""`elf-eval pareto`."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import METHOD, error_of, write_suite

from elf_eval.bench.pareto import Study
from elf_eval.cli import main
from elf_eval.report import plots
from elf_eval.report.pareto import markdown


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
    assert any(p["on_front"] for p in data["points"])
    assert data["about"]["image"] == "photo.png"
    assert (data["about"]["width"], data["about"]["height"]) == (160, 120)
    page = (tmp_path / "new" / "p.md").read_text()
    assert page in capsys.readouterr().out
    assert "| light (light) | place (turn, absent) |" in page
    results = json.loads((tmp_path / "s" / "results.json").read_text())
    lit = [p["metrics"]["ms"] for p in results["pairs"] if (p["scene"], p["method"]) == ("i_light", "SIFT")]
    assert f"| SIFT | {100 * np.mean(lit):.1f} | " in page
    assert (tmp_path / "new" / "p.png").exists() == plots.available()


def test_a_redrawn_page_is_the_same(measured, tmp_path):
    assert main(measured) == 0
    page = tmp_path / "new" / "p.md"
    before = page.read_text()
    page.unlink()
    assert main([*measured, "--redraw"]) == 0
    picture = "p.png" if plots.available() else None
    assert page.read_text() == before == markdown(Study.load(tmp_path / "new" / "p.json"), picture)


@pytest.mark.parametrize(
    ("change", "words"),
    [(["--reference", "SURF"], "no method 'SURF'"), (["--image", "none.png"], "none.png")],
)
def test_what_can_not_be_measured_is_named(measured, capsys, change, words, tmp_path):
    assert main([*measured, *change]) == 1
    assert words in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
