"""Results files that were edited by hand: one error with the file and the place."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import made_results
import pytest
from command_line import error_of

from elf_eval.run.results import Results


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "results.json"
    made_results.results([made_results.pair("s", n, made_results.PLACED) for n in (1, 2)]).save(path)
    return path


def test_what_is_saved_is_loaded(saved, tmp_path):
    Results.load(saved).save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == saved.read_text()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"protocol": {}}, "protocol.size is missing"),
        ({"protocol": 5}, "protocol: expected an object, found 5"),
        ({"methods": [{"paper": None}]}, "methods[0].name is missing"),
        ({"datasets": [{}]}, "datasets[0].name is missing"),
        ({"skipped": 5}, "skipped: expected a list, found 5"),
        ({"skipped": [{"name": "a"}]}, "skipped[0].reason is missing"),
        ({"versions": []}, "versions: expected an object, found []"),
        ({"created": None}, "created: expected text, found None"),
        ({"pairs": [5]}, "pairs[0]: expected an object, found 5"),
        ({"pairs": [{}]}, "pairs[0].dataset is missing"),
    ],
)
def test_what_is_wrong_is_said_with_its_file_and_place(change, reason, saved, capsys):
    saved.write_text(json.dumps(json.loads(saved.read_text()) | change))
    for command in (["report", str(saved)], ["compare", str(saved), str(saved)]):
        assert error_of(command, capsys) == [f"{saved}: not a results file of elf-eval run: {reason}"]


@pytest.mark.parametrize(("name", "value"), [("counts", []), ("max_keypoints", 0), ("size", [0, 5])])
def test_a_protocol_that_none_is_refused(name, value, saved, capsys):
    data = json.loads(saved.read_text())
    data["protocol"][name] = value
    saved.write_text(json.dumps(data))
    (line,) = error_of(["report", str(saved)], capsys)
    assert line.startswith(f"{saved}: not a results file of elf-eval run: protocol: {name} is ")


def test_a_method_may_have_any_letters_whatever_the_locale(saved, tmp_path):
    saved.write_text(saved.read_text().replace("SIFT", "\u00c9LF \u2603"), encoding="utf-8")
    words = [sys.executable, "-m", "elf_eval.cli", "report", str(saved), "--out", str(tmp_path / "o")]
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    ended = subprocess.run(words, env=os.environ | ascii_only, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert "\u00c9LF \u2603" in (tmp_path / "o" / "README.md").read_text(encoding="utf-8")
