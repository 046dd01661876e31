"""A quick run, and its results."""

from __future__ import annotations

import pytest

from elf_eval.cli import main


@pytest.fixture
def command(hpatches_folder, tmp_path):
    """A quick run of SIFT into ``out/a``; options behind it go before."""
    where = ["--dataset", f"hpatches:{hpatches_folder}", "--detector", "sift", "--out", str(tmp_path / "out" / "a")]
    return ["run", *where, "--cache", str(tmp_path / "c"), "--quiet", "--size", "160x120", "--threads", "1"]


@pytest.fixture
def results(command, tmp_path, capsys):
    assert main(command) == 0
    capsys.readouterr()
    return str(tmp_path / "out" / "a" / "results.json")
