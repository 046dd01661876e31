"""The command as a whole: help, wrong values, errors of the system, and what it needs to be installed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import error_of

from elf_eval.cli import build_parser, main
from helpers import ROOT


def test_a_reader_that_has_seen_enough_ends_the_command_quietly():
    reader, writer = os.pipe()
    os.close(reader)
    env = dict(os.environ)
    env.pop("PYTHONUNBUFFERED", None)  # with it, nothing is left to be flushed at exit
    command = [sys.executable, "-m", "elf_eval.cli", "list"]
    ended = subprocess.run(command, env=env, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (ended.returncode, ended.stderr) == (1, "")


def test_list_names_what_is_installed(capsys):
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    assert "hpatches" in text
    assert "sift" in text


def test_the_module_is_the_command():
    folders = ":".join(str(ROOT / name) for name in ("evaluation", "runtime"))
    command = [sys.executable, "-m", "elf_eval.cli", "list"]
    done = subprocess.run(command, env={"PYTHONPATH": folders}, capture_output=True, text=True, check=True)
    assert "datasets: hpatches" in done.stdout


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        *(("--size", text, "WIDTHxHEIGHT or source") for text in ("640", "0x480", "-640x480", "640x480x3")),
        *(("--max-keypoints", text, "a whole number from 1 on") for text in ("0", "-1", "many")),
    ],
)
def test_a_wrong_value_is_explained(command, option, value, words, capsys):
    with pytest.raises(SystemExit):
        main([*command, f"{option}={value}"])
    assert capsys.readouterr().err.splitlines()[-1].endswith(f"argument {option}: '{value}' is not {words}")


def test_the_system_s_errors_name_the_file_once(command, results, tmp_path, capsys):
    missing = str(tmp_path / "nofile")
    say = [f"{missing}: No such file or directory"]
    assert error_of(["run", missing, "--out", str(tmp_path / "o")], capsys) == say
    assert error_of(["report", missing], capsys) == say
    assert error_of(["compare", results, str(tmp_path)], capsys) == [f"{tmp_path}: not a file but a folder"]
    redraw = ["pareto", missing, results, "--image", missing, "--out", missing, "--redraw"]
    assert error_of(redraw, capsys) == [f"{missing}.json: No such file or directory"]
    (tmp_path / "d" / "i_light").mkdir(parents=True)
    (line,) = error_of([*command, "--detector", f"npz:{tmp_path / 'd'}"], capsys)
    assert line.endswith("1.png.npz: no features of i_light/1.png, nor of 5 others of 6 images")
    (tmp_path / "i" / "1.png").mkdir(parents=True)
    (tmp_path / "i" / "i_light").write_text("in the way")
    assert error_of(["images", command[2], "--out", str(tmp_path / "i")], capsys) == [
        f"{tmp_path / 'i' / 'i_light'}: File exists"
    ]


def test_every_option_has_its_help():
    (commands,) = (action for action in build_parser()._actions if action.metavar == "COMMAND")
    for name, parser in commands.choices.items():
        assert [action.dest for action in parser._actions if not action.help] == [], name
    assert "what to choose by (ms)" in commands.choices["sweep"].format_help()


_ROOT = Path(__file__).parents[3]


def test_the_evaluation_needs_neither_torch_nor_onnx():
    code = (
        "import sys, elf_eval.cli, elf_eval.report.plots; "
        "bad = {'torch', 'onnx', 'onnxscript', 'elf_export', 'matplotlib', 'h5py'} & sys.modules.keys(); "
        "assert not bad, bad"
    )
    paths = ":".join(str(_ROOT / part) for part in ("runtime", "evaluation"))
    subprocess.run([sys.executable, "-c", code], env={"PYTHONPATH": paths}, check=True)


def test_an_abbreviated_option_of_a_subcommand_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["report", "results.json", "--sui", "s.toml"])
    assert "unrecognized arguments: --sui" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (["sweep", "--planes", "4"], None),
        (["sweep", "--limits", "4"], "--limit"),
        (["depth", "--plane", "4"], "--planes"),
    ],
)
def test_only_options_of_the_subcommand_are_suggested(given, meant, capsys):
    required = {"sweep": ["--model", "sobel", "--dataset", "x"], "depth": ["x", "--out", "o"]}[given[0]]
    with pytest.raises(SystemExit):
        main([*given, *required])
    error = capsys.readouterr().err.rstrip()
    assert f"unrecognized arguments: {given[1]}" in error
    assert error.endswith(f"; did you mean {meant!r}?") if meant else "did you mean" not in error
