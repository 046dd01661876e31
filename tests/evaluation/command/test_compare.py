"""`elf-eval compare`, and what it says of wrong metrics and results."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import error_of, run_by_hand

from elf_eval.cli import main


def test_compare_two_runs_and_two_methods(hpatches_folder, tmp_path, capsys):
    a = run_by_hand(hpatches_folder, tmp_path, "a", "--detector", "sift", "--detector", "orb")
    b = run_by_hand(hpatches_folder, tmp_path, "b", "--detector", "sift", "--max-keypoints", "40")
    capsys.readouterr()
    assert main(["compare", a, b]) == 0
    text = capsys.readouterr().out
    assert "differs: protocol max_keypoints: 500 -> 40" in text
    line = next(line for line in text.splitlines() if " n1 " in line)
    assert line.split()[4:6] == ["2", "-17.00"]  # two scenes, whose differences are far apart
    assert line.endswith("noise")
    assert main(["compare", a, b, "--unit", "pair"]) == 0
    assert next(line for line in capsys.readouterr().out.splitlines() if " n1 " in line).endswith("fewer")
    assert main(["compare", a, a]) == 0
    same_again = capsys.readouterr().out.splitlines()[1:]
    assert same_again
    assert all(line.rstrip().endswith("noise") for line in same_again)
    assert main(["compare", a, a, "--method-a", "sift", "--method-b", "orb", "--unit", "pair"]) == 0
    assert "orb - sift" in capsys.readouterr().out
    assert main(["compare", a, b, "--method-a", "sift", "--method-b", "none"]) == 1
    assert "nothing to compare" in capsys.readouterr().err
    assert main(["compare", a, a, "--metrics", "h_error"]) == 1
    assert "can't be averaged" in capsys.readouterr().err


def test_unknown_metrics_are_named_with_those_there_are(results, capsys):
    for metrics in ("msx", "rep,msx"):
        (line,) = error_of(["compare", results, results, "--metrics", metrics], capsys)
        assert line.startswith("unknown metric 'msx'; these results have n1, n2, seen1, seen2, rep, ms, ")
        assert "_error" not in line
    (line,) = error_of(["compare", results, results, "--metrics", "rep,h_error"], capsys)
    assert line.startswith("h_error can't be averaged")


def test_a_metric_that_only_one_side_has_is_not_dropped(command, results, tmp_path, capsys):
    alone = [*command, "--out", str(tmp_path / "b")]
    alone[alone.index("sift")] = "gftt"
    assert main(alone) == 0
    capsys.readouterr()
    both = ["compare", results, str(tmp_path / "b" / "results.json"), "--method-a", "sift", "--method-b", "gftt"]
    assert main(both) == 0
    (line,) = error_of([*both, "--metrics", "rep,ms"], capsys)
    assert line == "nothing to compare by ms: no pair has it on both sides"


@pytest.mark.parametrize(
    "change",
    [{"protocol": None}, {"versions": "x"}, {"datasets": None}, {"datasets": [1]}, {"methods": {"a": 1}}, {"pairs": 5}],
)
def test_odd_results_are_no_results(results, tmp_path, capsys, change):
    data = json.loads(Path(results).read_text())
    odd = tmp_path / "odd.json"
    for text in (json.dumps({**data, **change}), "null", "[]", "[" * 100_000, "{"):
        odd.write_text(text)
        (line,) = error_of(["compare", results, str(odd)], capsys)
        assert line.startswith(f"{odd}: not a results file of elf-eval run: ")
