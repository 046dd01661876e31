"""What a command says on the way, with a bar and without."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from elf_runtime import ElfRuntime
from elf_runtime.commands import match_run, match_views, progress
from elf_runtime.commands.match import main as match
from elf_runtime.commands.progress import Progress
from helpers import TINY

from .scenes import write_views


class Bar:
    """Stands for tqdm's, and writes what happens to it among the lines."""

    def __init__(self, unit: str, total: int | None) -> None:
        self._unit = unit
        print(f"<{total} {unit}>")

    def update(self) -> None:
        print("<+1>")

    def clear(self) -> None:
        print("<clear>")

    def refresh(self) -> None:
        print("<refresh>")

    def close(self) -> None:
        print("<close>")


def test_results_are_above_the_bar(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(progress, "_bar", Bar)
    shown = Progress("elf-x", "pair", 3, sys.stdout)
    shown.found("a, b: 5 matches")
    shown.done("in a file")
    shown.close("all")
    assert capsys.readouterr().out.split("\n") == [
        "<3 pair>", "<clear>", "a, b: 5 matches", "<refresh>", "<+1>", "<+1>", "<close>", "all", "",
    ]  # fmt: skip


def test_without_a_bar_the_count_is_said_every_ten_seconds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = {"now": 0.0}
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock["now"])
    shown, quiet = Progress("elf-x", "image", 9, sys.stdout), Progress("elf-x", "image", 9, sys.stdout, quiet=True)
    for clock["now"] in (4.0, 8.0, 12.0, 16.0, 24.0):
        shown.step()
        quiet.step()
    captured = capsys.readouterr()
    assert captured.err == "elf-x: 3 of 9 images done\nelf-x: 5 of 9 images done\n"
    assert captured.out == ""


@pytest.mark.parametrize("which", ["exhaustive", "nearest:2"])
def test_elf_match_prints_its_pairs_beside_a_bar_that_knows_how_many(
    which: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_views(tmp_path, ["1.png", "2.png", "3.png"])
    monkeypatch.setattr(progress, "_bar", Bar)
    assert match([str(tmp_path), "--pairs", which, "--model", str(TINY), "--threads", "1", "--threshold", "none"]) == 0
    lines = capsys.readouterr().out.splitlines()
    # The images have a bar of their own, which is closed before that of the pairs.
    assert lines[:5] == ["<3 image>", "<+1>", "<+1>", "<+1>", "<close>"]
    lines = lines[5:]
    assert lines[0] == "<3 pair>"
    said = [line for line in lines if not line.startswith("<")]
    assert [line.partition(":")[0] for line in said[:3]] == ["1.png, 2.png", "1.png, 3.png", "2.png, 3.png"]
    assert said[3].startswith("3 pairs in ")


@pytest.mark.parametrize("which", ["exhaustive", "sequential", "nearest:1"])
def test_elf_match_detects_in_all_images_before_it_matches(
    which: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In turns, the threads of the network and of NumPy's products wait in each other's way."""
    write_views(tmp_path, ["1.png", "2.png", "3.png"])
    calls: list[str] = []

    def noted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arguments, **named: (calls.append(name), function(*arguments, **named))[1]

    monkeypatch.setattr(ElfRuntime, "detect", noted("detect", ElfRuntime.detect))
    for module, name in ((match_run, "match"), (match_views, "global_descriptor")):
        monkeypatch.setattr(module, name, noted(name, getattr(module, name)))
    assert match([str(tmp_path), "-q", "--pairs", which, "--model", str(TINY), "--threads", "1"]) == 0
    assert calls[:3] == ["detect"] * 3
    assert "detect" not in calls[3:]
    assert "match" in calls
