"""What elf-detect --engine ray writes to its two streams, where they are no terminal and workers die."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from elf_runtime.commands.command import Terminated, terminable
from elf_runtime.extraction.ray_engine import _own_signals
from helpers import TINY
from runtime.commands.detecting import write

pytest.importorskip("fsspec", reason="needs the extra ray")
pytest.importorskip("pyarrow", reason="needs the extra ray")
pytest.importorskip("ray", reason="needs the extra ray")

pytestmark = pytest.mark.xdist_group("ray")

COMMAND = """
import sys
import fsspec
from runtime.extraction.disk import Disk
from elf_runtime.commands.detect import main

fsspec.register_implementation("disk", Disk, clobber=True)
sys.exit(main(sys.argv[1:]))
"""


def test_a_worker_that_dies_writes_nothing_into_either_stream(tmp_path: Path) -> None:
    for index in range(2):
        write(tmp_path / "in" / f"{index}.png", index)
    kills = tmp_path / "in" / "1.png.kills"
    kills.write_text("1")
    words = [f"disk://{tmp_path}/in", "-o", "out", "--engine", "ray", "--workers", "1", "--jsonl", "-", "--model", TINY]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, *map(str, words)], cwd=tmp_path, capture_output=True, text=True, check=False,
        env={**environment, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "RAY_ADDRESS": "local"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert kills.read_text() == "0"
    assert [Path(json.loads(line)["image"]).name for line in done.stdout.splitlines()] == ["0.png", "1.png"]
    assert "1 times a worker had died" in done.stderr
    assert "\x1b" not in done.stderr
    assert "raylet" not in done.stderr


@pytest.mark.skipif(os.name == "nt", reason="there is no SIGTERM there")
@pytest.mark.parametrize("status", [1, 15])
def test_a_signal_while_ray_starts_is_no_exit_of_ray_s(status: int) -> None:
    """Ray sets handlers one after the other, whose exits have these statuses and say nothing."""
    before = signal.getsignal(signal.SIGTERM)

    def ray_s(*_: object) -> None:
        raise SystemExit(status)

    def starts() -> None:
        with terminable(), _own_signals():
            signal.signal(signal.SIGTERM, ray_s)
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(Terminated):
        starts()
    assert signal.getsignal(signal.SIGTERM) == before
