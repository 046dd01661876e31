"""Standard output and error that are closed or full: one line at most, and an exit status that is true."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from helpers import TINY

from .detecting import results, write

pytestmark = pytest.mark.skipif(not Path("/dev/full").exists(), reason="a POSIX shell and /dev/full are needed")


def shell(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """A command line, in which ELF stands for the module's command and MODEL for the small model's options."""
    command = line.replace("ELF-", f"{sys.executable} -m elf_runtime.commands.")
    command = command.replace("MODEL", f"--model {TINY} --threads 1")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(["sh", "-c", command], cwd=folder, env=environment, capture_output=True, text=True)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a", "b"):
        write(tmp_path / "few" / f"{name}.png", seed=ord(name))
    return tmp_path


def test_a_quiet_elf_info_says_errors_only(folder: Path) -> None:
    run = shell(f"ELF-info -q --provider cpu --json m.json {TINY}", folder)
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")
    assert (folder / "m.json").exists()
    run = shell("ELF-info -q few/a.png", folder)
    assert (run.returncode, run.stdout, run.stderr.count("\n")) == (1, "", 1)


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams_stop_no_work(closed: str, folder: Path) -> None:
    run = shell(f"ELF-detect few -o out MODEL {closed}", folder)
    assert (run.returncode, run.stderr) == (0, "")
    assert results(folder / "out") == {"few/a.npz", "few/b.npz"}
    run = shell(f"ELF-match few --pairs sequential --json m.json MODEL {closed}", folder)
    assert (run.returncode, run.stderr) == (0, "")
    assert (folder / "m.json").exists()
    assert ("matches" in run.stdout) == (closed == "2>&-")


def test_json_to_a_closed_output_is_refused(folder: Path) -> None:
    run = shell("ELF-match few --pairs sequential --json MODEL >&-", folder)
    assert run.returncode == 1
    assert run.stderr == "elf-match: error: standard output is closed, and --json writes to it; give it a file\n"


@pytest.mark.parametrize(
    ("line", "status", "error"),
    [
        ("ELF-detect absent.png -o out --json MODEL", 1, "elf-detect: error: absent.png: "),
        ("ELF-match few --pairs nonsense --json MODEL", 2, "elf-match: error: --pairs nonsense: "),
        ("ELF-match few -q --json MODEL", 1, "elf-match: error: No space left on device"),
        ("ELF-match few MODEL", 1, "elf-match: error: No space left on device"),
        ("ELF-info --json", 1, "elf-info: error: No space left on device"),
    ],
)
def test_a_full_output_is_one_line(line: str, status: int, error: str, folder: Path) -> None:
    run = shell(f"{line} > /dev/full", folder)
    assert run.returncode == status
    assert run.stderr.startswith(error)
    assert "Traceback" not in run.stderr
    assert "Exception ignored" not in run.stderr
