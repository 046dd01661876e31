"""elf-detect: what it names the results of an image."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from elf_runtime import Features
from elf_runtime.commands.inputs import image_files
from helpers import ROOT, TINY
from runtime.clips import clip
from runtime.commands.detecting import detect, results, write


@pytest.mark.parametrize(
    ("arguments", "base", "names"),
    [
        (["x/1.png", "2.png"], None, ["x/1", "2"]),
        (["a/1.png", "b/1.png"], None, ["a/1", "b/1"]),
        (["./a/1.png", "a/../b/1.png"], None, ["a/1", "a/b/1"]),
        (["a", "b"], None, ["a/1", "b/1"]),
        (["."], None, ["2", "a/1", "b/1", "x/1"]),
        (["a", "x/1.png"], "a/..", ["a/1", "x/1"]),
        (["ROOT/a/1.png"], None, ["1"]),
        (["ROOT/a", "ROOT/2.png"], None, ["1", "2"]),
        (["ROOT"], None, ["2", "a/1", "b/1", "x/1"]),
        (["ROOT/a", "ROOT/b"], "ROOT", ["a/1", "b/1"]),
        (["*/1.png"], None, ["a/1", "b/1", "x/1"]),
    ],
)
def test_a_name_depends_on_its_own_argument_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], base: str | None, names: list[str]
) -> None:
    for path in ("a/1.png", "b/1.png", "x/1.png", "2.png"):
        write(tmp_path / path)
    monkeypatch.chdir(tmp_path)
    given = [argument.replace("ROOT", str(tmp_path)) for argument in arguments]
    start = Path(base.replace("ROOT", str(tmp_path))) if base else None
    assert [str(name) for name in image_files(given, recursive=True, base=start).values()] == names
    for argument in given:
        alone = image_files([argument], recursive=True, base=start)
        assert {str(name) for name in alone.values()} <= set(names)


def test_two_images_of_one_name_in_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = write(tmp_path / "a" / "1.png"), write(tmp_path / "b" / "1.png", 1)
    for options in ([], ["--overwrite"]):
        assert detect(first, second, "-o", tmp_path / "out", "--no-picture", *options) == 1
        assert f"error: {second}: {tmp_path}/out/1.npz holds the results of {first}" in capsys.readouterr().err
        assert len(Features.load(tmp_path / "out" / "1.npz")) > 0
    assert detect(first, second, "-o", tmp_path / "both", "--no-picture", "--base", tmp_path) == 0
    assert results(tmp_path / "both") == {"a/1.npz", "b/1.npz"}


def test_images_that_differ_in_their_ending_only(tmp_path: Path) -> None:
    """Their names are the same whichever of them are in the run, and a picture of ours is no image."""
    first, second = write(tmp_path / "in" / "1.png"), write(tmp_path / "in" / "1.jpg", 1)
    write(tmp_path / "in" / "2.jpg")
    wanted = {"1.jpg.npz", "1.png.npz", "2.npz"}
    assert detect(tmp_path / "in", "-o", tmp_path / "out", "--no-picture") == 0
    assert results(tmp_path / "out") == wanted
    for image in (first, second):
        assert detect(image, "-o", tmp_path / "again", "--no-picture") == 0
    assert results(tmp_path / "again") == wanted - {"2.npz"}
    beside = write(tmp_path / "beside" / "3.jpg")
    for _ in range(2):
        assert detect(beside, "-o", tmp_path / "beside") == 0
        assert results(tmp_path / "beside") == {"3.npz"}


def test_a_name_without_its_ending_that_is_another_images_name(tmp_path: Path) -> None:
    names = ["a.jpg", "a.png", "a.png.jpg", "a.png.jpg.jpg", "b.png.jpg", "b.png"]
    for seed, name in enumerate(names):
        write(tmp_path / "in" / name, seed)
    wanted = {"a.jpg.npz", "a.png.npz", "a.png.jpg.npz", "a.png.jpg.jpg.npz", "b.npz", "b.png.npz"}
    assert detect(tmp_path / "in", "-o", tmp_path / "out", "--no-picture") == 0
    assert results(tmp_path / "out") == wanted
    for name in reversed(names):  # the same, whichever are in the run
        assert detect(tmp_path / "in" / name, "-o", tmp_path / "again", "--no-picture") == 0
    assert results(tmp_path / "again") == wanted
    assert detect(tmp_path / "in", "-o", tmp_path / "again", "--skip-existing", "--no-picture") == 0


def test_a_link_and_its_file_are_two_images(tmp_path: Path) -> None:
    image = write(tmp_path / "in" / "z.jpg")
    (tmp_path / "in" / "a.jpg").symlink_to("z.jpg")
    assert detect(tmp_path / "in", image, "-o", tmp_path / "out", "--no-picture") == 0
    assert results(tmp_path / "out") == {"a.npz", "z.npz"}


def test_an_image_that_fails_takes_no_name(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "q.png").write_bytes(b"GIF89a")
    good = write(tmp_path / "b" / "q.png")
    assert detect(tmp_path / "a" / "q.png", good, "-o", tmp_path / "out", "--no-picture") == 1
    assert results(tmp_path / "out") == {"q.npz"}


NAMES = [b"not\xff\xfeutf.png", "bl\u00e4tter \u6c34.png".encode(), b"tab\tand\nline\x1b[31m.png", b"x" * 200 + b".png"]


@pytest.mark.skipif(os.name == "nt", reason="names are Unicode there")
@pytest.mark.parametrize("encoding", ["ascii", "utf-8", "latin-1"])
def test_any_name_on_any_terminal(tmp_path: Path, encoding: str) -> None:
    image = write(tmp_path / "1.png").read_bytes()
    for name in NAMES:
        (tmp_path / "in" / os.fsdecode(name)).parent.mkdir(exist_ok=True)
        (tmp_path / "in" / os.fsdecode(name)).write_bytes(image)
    env = {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONPATH": str(ROOT / "runtime")}
    for module, arguments in (
        ("detect", ["in", "-o", "out", "--json", "s.json"]),
        ("match", [f"in/{os.fsdecode(NAMES[0])}", f"in/{os.fsdecode(NAMES[1])}", "-o", "m.png"]),
        ("detect", ["in/absent\udcff\x1b31m.png", "-o", "out"]),
    ):
        command = [sys.executable, "-m", f"elf_runtime.commands.{module}", *arguments, "--model", str(TINY)]
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, check=False)
        said = done.stdout + done.stderr
        assert b"Traceback" not in said, said.decode(errors="replace")
        assert done.returncode == int("absent" in arguments[0])
        assert b"\x1b" not in said
        assert said.count(b"\n") == {"in": 4 + 1}.get(arguments[0], 1)
    assert len(results(tmp_path / "out")) == 4
    assert len(json.loads((tmp_path / "s.json").read_text())["images"]) == 4


def test_results_keep_their_name_whatever_images_come_and_go(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    first = write(folder / "b.jpg")
    words = [folder, "-o", out, "--skip-existing", "--no-picture"]
    assert detect(*words) == 0
    assert results(out) == {"b.npz"}
    write(folder / "b.png", 1)
    assert detect(*words) == 0
    assert results(out) == {"b.npz", "b.png.npz"}
    assert "1 skipped" in capsys.readouterr().out
    first.unlink()
    assert detect(*words) == 0
    assert ": skipped, " in capsys.readouterr().out
    assert results(out) == {"b.npz", "b.png.npz"}


def test_videos_that_differ_in_their_ending_only(tmp_path: Path) -> None:
    for name in ("clip.avi", "clip.mkv", "other.avi"):
        clip(tmp_path / "in" / name)
    write(tmp_path / "in" / "other.jpg")
    videos = [tmp_path / "in" / name for name in ("clip.avi", "clip.mkv", "other.avi")]
    assert detect(*videos, "-o", tmp_path / "out", "--limit", 1) == 0
    assert results(tmp_path / "out") == {f"{name}/000000.npz" for name in ("clip.avi", "clip.mkv", "other")}


def test_a_video_whose_name_exists_comes_before_a_pattern(tmp_path: Path) -> None:
    clip(tmp_path / "clip1.avi")
    clip(tmp_path / "clip[1].avi")
    assert detect(tmp_path / "clip[1].avi", "-o", tmp_path / "out", "--limit", 1) == 0
    assert results(tmp_path / "out") == {"clip[1]/000000.npz"}
