"""elf-detect on many images at once, on videos and on cameras: what it writes, says, and leaves where it ends early."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime, Features
from elf_runtime.commands.cores import shared_cores
from elf_runtime.commands.progress import Progress
from elf_runtime.image.video import Video
from helpers import ROOT, TINY, textured
from runtime.clips import clip
from runtime.commands.detecting import detect, results, write


def test_any_number_of_workers_finds_the_same_in_the_same_order(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = [write(tmp_path / "in" / f"{i}.png", i) for i in range(9)]
    for workers in (1, 3):
        out = tmp_path / f"out{workers}"
        assert detect(tmp_path / "in", "-o", out, "--workers", workers, "--jsonl", "-") == 0
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert [line["image"] for line in lines] == list(map(str, images))
        assert [line["keypoints"] for line in lines] == [len(Features.load(line["files"][0])) for line in lines]
    for name in results(tmp_path / "out1"):
        one, three = (Features.load(tmp_path / out / name) for out in ("out1", "out3"))
        np.testing.assert_array_equal(one.keypoints, three.keypoints)
        np.testing.assert_array_equal(one.descriptors, three.descriptors)


def test_a_single_image_gets_a_picture_and_several_where_they_are_asked_for(tmp_path: Path) -> None:
    a, _ = write(tmp_path / "in" / "a.jpg"), write(tmp_path / "in" / "b.jpg", 1)
    for i, (words, pictures) in enumerate(
        [([a], 1), ([a, "--no-picture"], 0), ([a.parent], 0), ([a.parent, "--picture"], 2)]
    ):
        assert detect(*words, "-o", tmp_path / f"out{i}") == 0
        assert len(list((tmp_path / f"out{i}").rglob("*.png"))) == pictures


def test_failures_are_listed_at_the_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for i in range(5):
        write(tmp_path / "in" / f"{i}.png", i)
    (tmp_path / "in" / "1.png").write_text("no image")
    (tmp_path / "in" / "3.png").write_bytes(b"")
    assert detect(tmp_path / "in", "-o", tmp_path / "out", "--workers", 2, "--jsonl", tmp_path / "out" / "l.jsonl") == 1
    said = capsys.readouterr()
    *_, last, first_failed, second_failed = said.out.splitlines()
    assert last.startswith("5 images in ")
    assert last.endswith(" a second, 2 failed:")
    errors = [line.partition("error: ")[2] for line in said.err.splitlines()]
    assert [first_failed, second_failed] == [f"  {error}" for error in errors]
    assert "1.png: not an image" in first_failed
    assert "3.png: " in second_failed
    lines = list(map(json.loads, (tmp_path / "out" / "l.jsonl").read_text().splitlines()))
    assert [line.get("error") for line in lines] == [None, errors[0], None, errors[1], None]


def test_quiet_says_errors_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "a.png")
    assert detect(tmp_path / "a.png", tmp_path / "none.png", "-o", tmp_path / "out", "--quiet") == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.splitlines() == [f"elf-detect: error: {tmp_path}/none.png: No such file or directory"]


def test_an_end_keeps_what_is_done_and_a_second_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for i in range(30):
        write(tmp_path / "in" / f"{i:02d}.png", i)
    trace, calls = ElfRuntime.trace, []

    def interrupted(self: ElfRuntime, *given: object, **more: object) -> object:
        calls.append(1)
        if len(calls) == 8:
            raise KeyboardInterrupt
        return trace(self, *given, **more)

    monkeypatch.setattr(ElfRuntime, "trace", interrupted)
    assert detect(tmp_path / "in", "-o", tmp_path / "out", "--workers", 2, "--jsonl", tmp_path / "log") == 130
    assert "what is done stays, and --skip-existing goes on from there" in capsys.readouterr().err
    monkeypatch.undo()
    done = results(tmp_path / "out")
    assert 0 < len(done) < 30
    assert not list((tmp_path / "out").glob(".*"))
    assert all(json.loads(line) for line in (tmp_path / "log").read_text().splitlines())
    before = {name: (tmp_path / "out" / name).stat().st_mtime_ns for name in done}
    assert detect(tmp_path / "in", "-o", tmp_path / "out", "--skip-existing") == 0
    assert len(results(tmp_path / "out")) == 30
    assert {name: (tmp_path / "out" / name).stat().st_mtime_ns for name in done} == before
    assert f"{len(done)} skipped" in capsys.readouterr().out.splitlines()[-1]


def test_frames_of_a_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = clip(tmp_path / "in" / "clip.avi"), tmp_path / "out"
    words = [path, "-o", out, "--every", 4, "--json", tmp_path / "s.json"]
    assert detect(*words) == 0
    assert results(out) == {f"clip/{number:06d}.npz" for number in (0, 4, 8)}
    assert "clip.avi, frame 4: " in capsys.readouterr().out
    with Video(path) as video:
        frames = dict(video.read())
    elf = ElfRuntime(TINY, threads=1)
    for number in (0, 4, 8):
        found = Features.load(out / f"clip/{number:06d}.npz")
        np.testing.assert_array_equal(found.keypoints, elf.detect(frames[number]).keypoints)
    images = json.loads((tmp_path / "s.json").read_text())["images"]
    assert [(image["image"], image["frame"]) for image in images] == [(str(path), n) for n in (0, 4, 8)]
    assert detect(*words, "--skip-existing") == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith("3 skipped")
    clip(path, tuple(range(60, 180, 10)))
    assert detect(*words, "--skip-existing") == 0
    assert "skipped" not in capsys.readouterr().out


def test_a_camera_s_runs_have_folders_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, opened = str(clip(tmp_path / "a.avi")), cv2.VideoCapture
    monkeypatch.setattr(cv2, "VideoCapture", lambda source: opened(path if source == 1 else source))
    assert detect("--camera", 1, "-o", tmp_path / "out", "--limit", 2) == 0
    (run,) = (tmp_path / "out" / "camera1").iterdir()
    assert sorted(p.name for p in run.iterdir()) == ["000000.csv", "000000.npz", "000001.csv", "000001.npz"]


def test_a_video_that_is_none_among_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.mp4").write_text("words")
    clip(tmp_path / "good.avi")
    assert detect(tmp_path / "bad.mp4", tmp_path / "good.avi", "-o", tmp_path / "out", "--limit", 1) == 1
    assert results(tmp_path / "out") == {"good/000000.npz"}
    assert "bad.mp4: not a video that OpenCV can decode: it is text" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["-o", "out"], "nothing to detect in"),
        (["a.png", "-o", "out", "--every", "2"], "--every and --limit are for videos"),
        (["none*.mp4", "-o", "out"], "none*.mp4: no file matches"),
        (["a.png", "-o", "out", "--json", "-", "--jsonl", "-"], "can't both have standard output"),
        (["a.png", "-o", "out", "--jsonl", "a.png"], "--jsonl: a.png is an input image"),
        (["c.avi", "-o", "out", "--jsonl", "c.avi"], "--jsonl: c.avi is an input image"),
    ],
)
def test_command_lines_that_make_no_sense(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], reason: str
) -> None:
    write(tmp_path / "a.png")
    clip(tmp_path / "c.avi")
    monkeypatch.chdir(tmp_path)
    assert detect(*words) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert reason in error
    assert not (tmp_path / "out").exists()


def test_how_cores_are_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("elf_runtime.commands.cores.usable_cores", lambda: 8)
    assert shared_cores(None, None, 1) == (1, None)
    assert shared_cores(None, None, 500) == shared_cores(None, None, None) == (4, 2)
    assert shared_cores(None, 4, 500) == (2, 4)
    assert shared_cores(3, None, 500) == (3, 2)
    assert shared_cores(2, 16, 500) == (2, 16)
    assert shared_cores(1, None, 500) == (1, None)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_bar_on_a_terminal_and_lines_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("tqdm")
    for terminal, total, quiet, bar in ((True, 3, False, True), (True, 1, False, False), (False, 3, False, False),
                                        (True, 3, True, False)):  # fmt: skip
        errors, lines = Terminal() if terminal else io.StringIO(), io.StringIO()
        monkeypatch.setattr(sys, "stderr", errors)
        progress = Progress("elf-detect", "image", total, lines, quiet)
        progress.done("a is done")
        progress.failed("b is not")
        progress.advance()
        progress.close("the end")
        assert ("2/3" in errors.getvalue()) is bar
        assert "elf-detect: error: b is not\n" in errors.getvalue()
        assert ("a is done" in lines.getvalue()) is not (bar or quiet)
        assert ("the end" in lines.getvalue()) is not quiet


def test_max_side_bounds_what_the_network_sees(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(240, 400))
    assert detect(tmp_path / "a.png", "-o", tmp_path / "out", "--max-side", 100, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["settings"]["max_side"] == 100
    found = Features.load(tmp_path / "out" / "a.npz")
    wanted = ElfRuntime(TINY, threads=1).detect(tmp_path / "a.png", scale=0.25)
    np.testing.assert_array_equal(found.keypoints, wanted.keypoints)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads Linux's own figures")
def test_memory_stays_flat(tmp_path: Path) -> None:
    """Of 60 images of a megabyte each, no more than the few under way are held."""
    for i in range(60):
        cv2.imwrite(str(tmp_path / f"{i:02d}.jpg"), np.full((600, 600, 3), i, np.uint8))
    script = (
        "import sys; from pathlib import Path; from elf_runtime.commands.detect import main\n"
        "main(sys.argv[1:]); print([l for l in open('/proc/self/status') if 'VmHWM' in l][0].split()[1])"
    )
    peaks = []
    for images in ("0[0-7].jpg", "*.jpg"):
        words = [str(tmp_path / images), "-o", str(tmp_path / "out"), "--model", str(TINY), "--workers", "2", "-q"]
        env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
        done = subprocess.run(
            [sys.executable, "-c", script, *words, "--overwrite"], env=env, capture_output=True, text=True, check=True
        )
        peaks.append(int(done.stdout.split()[-1]) / 1024)
    assert peaks[1] - peaks[0] < 20, peaks


def test_a_disk_that_is_full_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    for i in range(20):
        write(tmp_path / "in" / f"{i:02d}.png", i)
    monkeypatch.setattr("elf_runtime.files.write.os.replace", full)
    assert detect(tmp_path / "in", "-o", tmp_path / "out", "--workers", 2) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "00.npz: No space left on device" in error


def test_what_takes_long_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("elf_runtime.commands.patience.SECONDS", 0.01)
    trace = ElfRuntime.trace

    def slow(self: ElfRuntime, *given: object, **more: object) -> object:
        time.sleep(0.3)
        return trace(self, *given, **more)

    monkeypatch.setattr(ElfRuntime, "trace", slow)
    image = write(tmp_path / "a.png")
    assert detect(image, "-o", tmp_path / "out") == 0
    assert capsys.readouterr().err == f"elf-detect: {image} takes a while ...\n"
    assert detect(image, "-o", tmp_path / "out", "--quiet") == 0
    assert capsys.readouterr().err == ""


def test_a_side_below_what_the_network_takes_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert detect(write(tmp_path / "a.png"), "-o", tmp_path / "out", "--max-side", 5) == 1
    assert "max_side is 5, and" in capsys.readouterr().err
