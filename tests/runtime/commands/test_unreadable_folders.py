"""Folders that can't be listed and links that lead nowhere are failures by name, and all else is done."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any

import pytest

from elf_runtime.commands import match, reconstruct, view
from elf_runtime.commands.detect_ray import _frames
from elf_runtime.commands.inputs import image_files
from elf_runtime.errors import ElfError
from helpers import TINY
from runtime.commands.detecting import detect, results, write

MODEL = ("--model", str(TINY), "--threads", "1")


@pytest.fixture
def shut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """``in`` with two images beside the folder ``in/shut``, which nobody may list; the working folder is its own."""
    monkeypatch.chdir(tmp_path)
    for name in ("a.png", "b.png", "open/c.png", "shut/d.png"):
        write(Path("in", name))
    may_list = os.scandir

    def scandir(path: Any = ".") -> Any:
        if not isinstance(path, int) and Path(os.fspath(path)).name == "shut":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), os.fspath(path))
        return may_list(path)

    monkeypatch.setattr(os, "scandir", scandir)
    return Path("in/shut")


@pytest.mark.parametrize(
    "given",
    [
        ("in", "-r"),
        ("in/*/*.png", "in"),
        ("in/**/*.png",),
        ("in", "in/shut", "in/open"),
        ("in", "in/open", "in/*/*.mp4"),
    ],
)
def test_detect_says_which_folder_it_could_not_list(
    shut: Path, given: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert detect(*given, "-o", "out", "--no-picture", "--json", "run.json") == 1
    said = capsys.readouterr()
    assert "error: in/shut: Permission denied\n" in said.err
    assert said.out.endswith("1 failed:\n  in/shut: Permission denied\n")
    assert results(Path("out")) == {"in/a.npz", "in/b.npz", "in/open/c.npz"}
    failed = [image for image in json.loads(Path("run.json").read_text())["images"] if "error" in image]
    assert failed == [{"image": "in/shut", "error": "in/shut: Permission denied"}]


def test_a_named_image_in_a_folder_that_can_not_be_entered(
    shut: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stat, place = os.stat, os.path.abspath(shut)

    def refuses(path: Any, **options: Any) -> Any:
        if not isinstance(path, int) and os.path.dirname(os.path.abspath(path)) == place:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), os.fspath(path))
        return stat(path, **options)

    monkeypatch.setattr(os, "stat", refuses)
    for options in (["--no-picture"], ["--picture"]):
        assert detect("in/shut/d.png", "in/shut/d.png.jpg", "in/a.png", "-o", "out", "--overwrite", *options) == 1
        said = capsys.readouterr().err
        assert "error: in/shut/d.png: Permission denied\n" in said
        assert "error: in/shut/d.png.jpg: Permission denied\n" in said
        assert results(Path("out")) == {"in/a.npz"}


def test_a_folder_alone_that_can_not_be_listed(shut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert detect("in/shut", "-o", "out") == 1
    assert "in/shut: Permission denied" in capsys.readouterr().err
    assert match.main(["in/shut", *MODEL]) == 1
    assert "in/shut: Permission denied" in capsys.readouterr().err


def test_match_matches_the_others(shut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for which, summary in (((), "3 pairs in"), (("--pairs", "nearest:1"), "1 of the images and folders left out")):
        assert match.main(["in", "-r", *which, *MODEL, "--json", "pairs.json"]) == 1
        said = capsys.readouterr()
        assert said.err.count("in/shut: Permission denied") == 1
        assert summary in said.out
        found = json.loads(Path("pairs.json").read_text())
        assert {"image": "in/shut", "error": "in/shut: Permission denied"} in found["images"]
        assert not any("shut" in pair[end] for pair in found["pairs"] for end in "ab")
    assert match.main(["in/a.png", "in", "-r", *MODEL]) == 1
    assert "in/shut: Permission denied" in capsys.readouterr().err


def test_match_and_view_take_results_beside_a_shut_folder(shut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert detect("in", "-o", "out", "--no-picture", "-q") == 0
    Path("out/shut").mkdir()
    assert match.main(["out", "-r"]) == 1
    said = capsys.readouterr()
    assert "in/a.npz, in/b.npz: " in said.out
    assert "out/shut: Permission denied" in said.err
    assert view.main(["out", "-o", "results.html", "--model", str(TINY)]) == 1
    said = capsys.readouterr()
    assert "2 images -> results.html" in said.out
    assert "Permission denied" in said.err
    assert "out/shut" in said.err


def test_view_shows_the_others(shut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert view.main(["in", "-r", "-o", "view.html", *MODEL]) == 1
    said = capsys.readouterr()
    assert "3 images -> view.html" in said.out
    assert "in/shut: Permission denied" in said.err


def test_reconstruct_says_it(shut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pycolmap", reason="needs the extra sfm")
    assert reconstruct.main(["in", "-o", "out", *MODEL]) == 1
    assert "in/shut: Permission denied" in capsys.readouterr().err


@pytest.mark.parametrize("url", [False, True])
@pytest.mark.parametrize("given", [["in"], ["in/*/*.png"]])
def test_what_ray_is_given_has_the_folder(shut: Path, given: list[str], url: bool) -> None:
    pytest.importorskip("fsspec", reason="needs the extra ray")
    from argparse import Namespace

    words = [f"file://{Path(word).absolute()}" if url else word for word in given]
    frames = {frame.stem.name: frame for frame in _frames(Namespace(images=words, recursive=True, base=None))}
    assert frames.keys() == {*(["a.png", "b.png"] if given == ["in"] else []), "c.png", "shut"}
    with pytest.raises(ElfError, match=r"shut: (Permission denied|it can't be listed)"):
        frames["shut"].open(None)


def test_links_that_lead_nowhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "gone.png").symlink_to("nowhere.png")
    (folder / "loop.png").symlink_to("loop.png")
    (folder / "notes.txt").symlink_to("nowhere.txt")
    assert detect(folder, "-o", tmp_path / "none") == 1  # nothing but such links
    assert "gone.png: No such file or directory" in (said := capsys.readouterr().err)
    assert "loop.png: Too many levels of symbolic links" in said
    assert "notes.txt" not in said
    image = write(folder / "a.png")
    for given in (folder, folder / "*.png"):
        assert list(image_files([str(given)])) == [image, folder / "gone.png", folder / "loop.png"]
    assert detect(folder, "-o", tmp_path / "out", "--no-picture") == 1
    assert results(tmp_path / "out") == {"a.npz"}
    pytest.importorskip("fsspec", reason="needs the extra ray")
    from elf_runtime.extraction.remote import remote_images

    found = remote_images(f"file://{folder}", False, {".png"})
    assert [frame.stem.name for frame in found] == ["a.png", "gone.png", "loop.png"]
