"""`elf-eval run`: every file of a report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run_by_hand

from elf_eval.cli import main
from elf_eval.report import plots
from elf_eval.run.results import Results

SUITE = """
title = "Two scenes"
note = "Only a test."
[variables]
FOLDER = "{folder}"
[protocol]
size = [160, 120]
max_keypoints = 60
counts = ["own", "equal"]
[[dataset]]
name = "two"
spec = "hpatches:${{FOLDER}}"
[[dataset]]
name = "turned"
spec = "rotation:${{FOLDER}}"
[[method]]
name = "SIFT"
detector = "sift"
paper = "SIFT"
[[method]]
name = "FAST + ORB"
detector = "fast"
descriptor = "orb"
[[method]]
name = "XFeat"
detector = "xfeat:nowhere.onnx"
optional = true
[[table]]
title = "All"
[[table]]
title = "Turned"
datasets = ["turned"]
plot = "curves"
[[table]]
title = "Accuracy"
datasets = ["two"]
plot = "mma"
[[picture]]
dataset = "two"
pair = "v_turn/1.png - v_turn/3.png"
"""


@pytest.fixture
def suite_file(hpatches_folder, tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SUITE.format(folder=hpatches_folder))
    return path


def test_one_command_makes_the_whole_report(suite_file, tmp_path, capsys):
    out = tmp_path / "out"
    command = ["run", str(suite_file), "--out", str(out), "--cache", str(tmp_path / "c"), "--quiet"]
    assert main(command) == 0
    folder = out / "small"
    markdown = (folder / "README.md").read_text()
    for words in (
        "Two scenes",
        "Only a test.",
        "Not measured: XFeat",
        "51.2 / 24.6",
        "equal counts",
        "160x120",
    ):
        assert words in markdown
    assert markdown in capsys.readouterr().out
    assert "| FAST + ORB | " in markdown
    assert len(list((folder / "pictures").glob("*.jpg"))) == 2
    assert not (folder / "unfinished.jsonl").exists()
    assert "two,own,SIFT,rep," in (folder / "tables.csv").read_text()
    results = Results.load(folder / "results.json")
    data = json.loads((folder / "results.json").read_text())
    assert len(data["pairs"]) == len(results.pairs) == (4 + 12) * 2 * 2
    assert {"numpy", "opencv", "onnxruntime"} <= data["versions"].keys()
    assert all(len(d["sha256"]) == 64 for d in data["datasets"])
    assert str(tmp_path) not in (folder / "results.json").read_text()
    if plots.available():
        drawn = sorted(p.name for p in (folder / "plots").iterdir())
        assert {"01-two-own.png", "02-turned-equal.png", "03-two-own.png"} <= set(drawn)
        assert all(f"plots/{name}" in markdown for name in drawn)
    (folder / "README.md").unlink()
    suite_file.write_text(suite_file.read_text().replace('paper = "SIFT"', 'paper = "SURF"'))
    assert main(["report", str(folder / "results.json"), "--suite", str(suite_file)]) == 0
    again = (folder / "README.md").read_text()
    assert "pictures/" in again
    assert "54.5 / 26.1" in again
    assert "51.2 / 24.6" not in again


def test_the_index_has_the_pages_of_earlier_runs_too(suite_file, tmp_path):
    out = tmp_path / "out"
    (out / "before").mkdir(parents=True)
    (out / "before" / "README.md").write_text("# An earlier run\n\nFigures.\n")
    (out / "times.md").write_text("# Time and matching score\n")
    assert main(["run", str(suite_file), "--out", str(out), "--cache", str(tmp_path / "c"), "--quiet"]) == 0
    links = [line for line in (out / "README.md").read_text().splitlines() if line.startswith("- ")]
    assert links == [
        "- [An earlier run](before/README.md)",
        "- [Two scenes](small/README.md)",
        "- [Time and matching score](times.md)",
    ]


def test_an_output_that_can_t_be_written_is_one_line(suite_file, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert main(["run", str(suite_file), "--out", str(tmp_path / "file" / "out"), "--quiet"]) == 1
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert "file" in error[0]


def test_detector_and_descriptor_apart_on_the_command_line(hpatches_folder, tmp_path):
    path = run_by_hand(
        hpatches_folder, tmp_path, "a", "--detector", "fast", "--detector", "gftt", "--descriptor", "orb"
    )
    assert [m["name"] for m in json.loads(Path(path).read_text())["methods"]] == ["fast + orb", "gftt + orb"]
