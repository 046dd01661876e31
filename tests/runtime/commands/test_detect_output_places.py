"""elf-detect: where it may write, checked before the work, and that it never writes over an input."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from elf_runtime import ElfRuntime
from elf_runtime.commands.detect import main
from helpers import TINY
from runtime.commands.detecting import detect, write


def test_a_folder_is_made_only_for_what_goes_into_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = write(tmp_path / "small.png", size=(8, 8))
    assert detect(small, "-o", tmp_path / "new") == 1
    assert f"{small}: the image has 8x8 pixels" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    assert detect(small, "-o", tmp_path / "new", "--json", tmp_path / "new" / "summary.json") == 1
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["summary.json"]


def test_an_input_image_is_never_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = write(tmp_path / "a.png")
    before = image.read_bytes()
    assert detect(image, "-o", tmp_path) == 2
    assert "is an input image" in capsys.readouterr().err
    assert image.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["in", "-o", "in"], "-o in: the pictures would be taken for images of the folder in next time"),
        (["in", "-o", "in/../in"], "for images of the folder in"),
        (["-r", ".", "-o", "in/new"], "for images of the folder ."),
        (["in/*.png", "-o", "in"], "in/b.png is a picture that elf-detect wrote"),
        (["in/b.png", "-o", "elsewhere"], "in/b.png is a picture that elf-detect wrote"),
    ],
)
def test_pictures_are_not_written_where_images_are_taken_from(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    reason: str,
) -> None:
    write(tmp_path / "in" / "b.jpg")
    monkeypatch.chdir(tmp_path)
    if "b.png" in reason:
        assert detect("in/b.jpg", "-o", ".") == 0
    before = sorted(tmp_path.rglob("*"))
    capsys.readouterr()
    assert detect(*arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert reason in error
    assert "picture" in error.partition(";")[2]
    assert sorted(tmp_path.rglob("*")) == before
    assert detect(*arguments, "--no-picture") == 0


def test_results_may_lie_beside_the_images(tmp_path: Path) -> None:
    image = write(tmp_path / "a.jpg")
    for _ in range(2):
        assert detect(image, "-o", tmp_path) == 0
        assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "a.jpg", "a.npz", "a.png"]


def test_a_hard_link_to_an_input_is_not_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "in" / "a.png"), tmp_path / "out"
    out.mkdir()
    os.link(image, out / "a.png")
    before = image.read_bytes()
    assert detect(image, "-o", out) == 2
    assert "is an input image" in capsys.readouterr().err
    assert image.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        (["p.png", "-o", ".", "--mask", "m/p.png", "--no-picture", "--jsonl", "m/p.png"], 2, "m/p.png is the mask"),
        (["q.jpg", "-o", "m", "--mask", "m/q.png"], 2, "-o: m/q.png is the mask"),
        (["q.jpg", "-o", "m", "--mask", "link.png"], 2, "-o: m/q.png is the mask"),
        (["p.png", "-o", "out", "--jsonl", "p.png"], 2, "--jsonl: p.png is an input image"),
        (["m/p.png", "p.png", "-o", "out", "--jsonl", "./p.png"], 2, "--jsonl: p.png is an input image"),
        (["q.jpg", "-o", "out", "--jsonl", "out/q.png"], 2, "--jsonl: out/q.png is an output of -o"),
        (["p.jpg", "-o", "out", "--jsonl", "out/p.jpg.png"], 2, "--jsonl: out/p.jpg.png is an output of -o"),
        (["p.jpg", "-o", "out", "--jsonl", "model.onnx"], 2, "--jsonl: model.onnx is the model"),
        (["p.jpg", "-o", "out", "--json", "nodir/x.json"], 1, "--json: there is no folder nodir"),
        (["p.jpg", "-o", "out", "--json", "p.png/x.json"], 1, "--json: p.png is not a folder"),
        (["p.jpg", "-o", "out", "--jsonl", "m"], 1, "--jsonl: m exists and is not a file"),
        (["p.jpg", "-o", "out", "--json", "link.json"], 2, "--json: link.json is an input image"),
        (["p.jpg", "-o", "p.png"], 1, "-o: p.png is not a folder"),
        (["p.jpg", "-o", "p.png/out"], 1, "-o: "),
    ],
)
def test_outputs_are_checked_before_the_work(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    status: int,
    reason: str,
) -> None:
    for seed, name in enumerate(("p.png", "p.jpg", "q.jpg", "m/p.png", "m/q.png")):
        write(tmp_path / name, seed)
    (tmp_path / "link.png").symlink_to("m/q.png")
    (tmp_path / "link.json").symlink_to("p.jpg")
    (tmp_path / "model.onnx").write_bytes(TINY.read_bytes())
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ElfRuntime, "trace", None)  # no image gets that far
    assert main([*arguments, "--model", "model.onnx", "--threads", "1"]) == status
    error = capsys.readouterr().err
    assert error.startswith("elf-detect: error: ")
    assert error.count("\n") == 1
    assert reason in error
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_summary_may_lie_in_the_folder_that_is_made(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    for summary in (out / "summary.json", tmp_path / "new" / "summary.json"):
        assert detect(write(tmp_path / "a.png"), "-o", out, "--json", summary) == 0
        assert json.loads(summary.read_text())["images"]
    assert detect(tmp_path / "a.png", "-o", out, "--json", out / "summary.json") == 0  # written again


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_is_read_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "a.png"), tmp_path / "out"
    out.mkdir(mode=0o500)
    assert detect(image, "-o", out) == 1
    assert "nothing can be written into the folder" in capsys.readouterr().err


def test_no_part_of_a_file_is_left_where_writing_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    image, out = write(tmp_path / "a.png"), tmp_path / "out"
    monkeypatch.setattr("elf_runtime.files.write.os.replace", full)
    assert detect(image, "-o", out) == 1
    assert "No space left" in capsys.readouterr().err
    assert not list(out.glob("*.png"))
    assert not [p for p in out.iterdir() if p.suffix == ".png" or ".part.png" in p.name]
