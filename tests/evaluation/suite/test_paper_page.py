"""The commands in the table of docs/reproduce.md run as printed, on miniatures by the names of the page."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import pytest
from publishers import write_publishers
from scenes import write_hpatches

from elf_eval.cli import main
from elf_eval.report import plots
from helpers import ROOT
from project.code_blocks import spans_in

PAGE = (ROOT / "docs" / "reproduce.md").read_text(encoding="utf-8")
# The table's, without the name of the program.
COMMANDS = [list(words[1:]) for _, whole, words in spans_in(PAGE) if whole and words[0] == "elf-eval"]
FOLDERS = {
    "hpatches": "hpatches-sequences-release",
    "webcam": "WebcamRelease",
    "strecha": "strecha",
    "models": "models",
}


@pytest.fixture
def top(tmp_path, monkeypatch):
    """A folder as the page has it, and the working one."""
    for name in [name for name in os.environ if name.startswith("ELF_")]:
        monkeypatch.delenv(name)
    write_publishers(tmp_path)
    for name, published in FOLDERS.items():
        (tmp_path / name).rename(tmp_path / published)
    oxford = tmp_path / "data" / "oxford_affine"
    oxford.mkdir(parents=True)
    write_hpatches(oxford, ["v_graf"])
    for path in oxford.glob("*/*.png"):
        path.rename(path.with_suffix(".ppm"))  # a picture is known by what is in it
    for name in ("evaluation", "demo"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.setenv("ELF_IMAGE_MATCHING", "strecha:strecha")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def small(command: list[str], top: Path) -> list[str]:
    """The command for small images and few keypoints."""
    if command[0] == "depth":
        return [*command, "--side", "64", "--planes", "16", "--quiet"]
    if command[0] == "figures" and command[1] not in ("layers", "gradients", "matches"):
        return command
    limits = ["--size", "160x120", "--max-keypoints", "40", "--threads", "1", "--cache", str(top / "c"), "--quiet"]
    limits += ["--count-floor", "20"] if command[0] == "run" else []
    limits += ["--limit", "3"] if command[0] == "sweep" else []
    return [*command, *limits, *(["--sizes", "2", "--subsets", "1"] if command[0] == "sfm" else [])]


@pytest.mark.skipif(not plots.available(), reason="matplotlib is not installed")
def test_every_command_of_the_table_runs(top, capsys):
    assert {words[0] for words in COMMANDS} == {"run", "figures", "sweep", "sfm", "depth"}
    for command in COMMANDS:
        if command[0] == "sfm" and importlib.util.find_spec("pycolmap") is None:
            continue
        assert main(small(command, top)) == 0, f"{command}: {capsys.readouterr().err}"
        if "--out" in command:
            assert (top / command[command.index("--out") + 1]).exists()
