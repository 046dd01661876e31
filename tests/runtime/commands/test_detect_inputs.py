"""elf-detect: which images a folder, a pattern or a link stands for."""

from __future__ import annotations

from pathlib import Path

import pytest

from elf_runtime.commands.inputs import image_files
from runtime.commands.detecting import detect, results, write


def test_folders_patterns_and_repeated_files(tmp_path: Path) -> None:
    a, b = write(tmp_path / "in" / "a.png"), write(tmp_path / "in" / "b.JPG")
    (tmp_path / "in" / "notes.txt").write_text("no image")
    (tmp_path / "in" / "folder.png").mkdir()
    assert list(image_files([str(tmp_path / "in")])) == [a, b]
    assert list(image_files([str(tmp_path / "in" / "*.png"), str(a)])) == [a]
    assert list(image_files([str(b), str(tmp_path / "in")])) == [b, a]


def test_subfolders_are_looked_into_where_that_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = write(tmp_path / "in" / "x" / "1.png"), write(tmp_path / "in" / "y" / "z" / "1.png", 1)
    assert detect(tmp_path / "in", "-o", tmp_path / "out") == 2
    assert "in this folder; --recursive looks below it too" in capsys.readouterr().err
    assert list(image_files([str(tmp_path / "in")], recursive=True)) == [first, second]
    assert detect(tmp_path / "in", "-r", "-o", tmp_path / "out", "--no-picture") == 0
    assert results(tmp_path / "out") == {"x/1.npz", "y/z/1.npz"}
    (tmp_path / "empty").mkdir()
    assert detect(tmp_path / "empty", "-r", "-o", tmp_path / "out") == 2
    assert "in this folder or below it\n" in capsys.readouterr().err


def test_hidden_files_of_a_folder_are_no_images(tmp_path: Path) -> None:
    shown = write(tmp_path / ".home" / "in" / "1.png")
    for hidden in ("._1.png", ".cache/2.png", "x/.3.png"):
        write(shown.parent / hidden)
    assert list(image_files([str(shown.parent)], recursive=True)) == list(image_files([str(shown.parent)])) == [shown]


def test_pictures_beside_their_images_are_no_images_of_the_folder(tmp_path: Path) -> None:
    image = write(tmp_path / "in" / "x.jpg")
    assert detect(image, "-o", image.parent) == 0
    for options in ([], ["--no-picture"]):
        out = tmp_path / f"out{len(options)}"
        assert detect(image.parent, "-o", out, *options) == 0
        assert results(out) == {"x.npz"}
    own = write(tmp_path / "own" / "y.png")
    for _ in range(2):  # its own features beside it do not make it a picture of ours
        assert detect(own, "-o", own.parent, "--no-picture") == 0
        assert detect(own.parent, "-o", tmp_path / "out") == 0
    assert "y.npz" in results(tmp_path / "out")


def test_a_loop_of_links_is_an_error_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "loop.png").symlink_to(tmp_path / "loop.png")
    assert detect(tmp_path / "loop.png", write(tmp_path / "1.png"), "-o", tmp_path / "out", "--no-picture") == 1
    assert "loop.png: Too many levels of symbolic links" in capsys.readouterr().err
    assert results(tmp_path / "out") == {"1.npz"}


def test_an_empty_folder_and_an_empty_pattern_are_usage_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert detect(tmp_path, "-o", tmp_path / "out") == 2
    assert "no images" in capsys.readouterr().err
    assert detect(tmp_path / "*.png", "-o", tmp_path / "out") == 2
    assert "no file matches" in capsys.readouterr().err
