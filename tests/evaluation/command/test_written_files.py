"""What a command leaves behind when something is wrong, and what it says it wrote."""

from __future__ import annotations

import json
import os

import pytest
from command_line import METHOD, error_of, write_suite

from elf_eval.cli import main
from elf_eval.report import plots


@pytest.mark.parametrize(
    "wrong",
    [["--detector", "elff"], ["--dataset", "x=hpatches:nowhere"], ["--descriptor", "mser"]],
)
def test_a_run_that_fails_before_its_first_result_leaves_nothing(command, wrong, tmp_path):
    assert main([*command, *wrong]) == 1
    assert not (tmp_path / "out").exists()


def test_an_interrupted_command_goes_on_where_it_was(command, tmp_path, interrupted_at):
    calls = interrupted_at(3)
    assert main(command) == 130
    assert [path.name for path in (tmp_path / "out" / "a").iterdir()] == ["unfinished.jsonl"]
    assert main(command) == 0
    assert len(calls) == 3 + 2
    assert not (tmp_path / "out" / "a" / "unfinished.jsonl").exists()
    assert len(json.loads((tmp_path / "out" / "a" / "results.json").read_text())["pairs"]) == 4


@pytest.mark.parametrize("under", ["", "/deeper"])
def test_a_file_in_the_place_of_the_folder_is_found_before_any_work(command, results, under, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    cache = ["--cache", str(tmp_path / "new")]
    out = ["--out", f"{tmp_path / 'file'}{under}"]
    others = ["report", results, *out], ["images", command[2], *out]
    for arguments in ([*command, *out, *cache], *others):
        assert error_of(arguments, capsys) == [f"{tmp_path / 'file'} is not a folder"]
    assert not (tmp_path / "new").exists()


def test_a_folder_that_can_t_be_written_into_is_found_before_any_work(command, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(os, "access", lambda path, _: path != tmp_path)
    assert error_of(command, capsys) == [f"nothing can be written into the folder {tmp_path}"]
    assert not (tmp_path / "c").exists()


def test_a_picture_is_no_suite(photo_file, tmp_path, capsys):
    (line,) = error_of(["run", str(photo_file), "--out", str(tmp_path / "o")], capsys)
    assert line.startswith(f"{photo_file}: not a TOML file: ")


PICTURE = "[[picture]]\ndataset = 'two'\npair = 'v_turn/1.png - v_turn/3.png'\n"


@pytest.mark.parametrize("drawn", [True, False])
def test_the_last_line_names_what_was_written(hpatches_folder, tmp_path, drawn, monkeypatch, capsys):
    if drawn and not plots.available():
        pytest.skip("no matplotlib")
    monkeypatch.setattr(plots, "available", lambda: drawn)
    methods = [METHOD.format("SIFT", "sift"), PICTURE] if drawn else [METHOD.format("SIFT", "sift")]
    run = write_suite(tmp_path / "s.toml", hpatches_folder, methods)
    assert main(run) == 0
    folder = tmp_path / "o" / "s"
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1] == f"written: {tmp_path / 'o'}/README.md"
    named = lines[-2].removeprefix(f"written: {folder}/").split(", ")
    assert set(named) == {path.name + "/" * path.is_dir() for path in folder.iterdir()}
    assert {"plots/", "pictures/"} <= set(named) or not drawn
    again = tmp_path / "again"
    assert main(["report", str(folder / "results.json"), "--out", str(again)]) == 0
    line = capsys.readouterr().err.strip()
    assert line == f"written: {again}/README.md, tables.csv" + ", plots/" * drawn
    page = (folder / "README.md").read_text()
    assert "pip install" not in page
    assert ("matplotlib is not installed (it is in the extra 'eval')." in page) == (not drawn)


def test_a_picture_of_no_pair_is_an_error_before_anything_runs(hpatches_folder, tmp_path, capsys):
    wrong = PICTURE.replace("3.png", "9.png")
    run = write_suite(tmp_path / "s.toml", hpatches_folder, [METHOD.format("SIFT", "sift"), wrong])
    (line,) = error_of(run, capsys)
    assert line.startswith("picture 'v_turn/1.png - v_turn/9.png': no such pair in ")
    assert "which has '" in line
    assert not (tmp_path / "o").exists()
    assert not (tmp_path / "c").exists()
