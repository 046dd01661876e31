"""A run's processes: they end with the one that started them, and what was finished is kept."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from elf_eval.cli import main
from elf_eval.errors import EvalError
from elf_eval.run.workers import run_all

# A detector that takes its time, and writes down which process it runs in.
PLUGIN = """
import os, time
from pathlib import Path
from elf_eval.features import LocalFeatures
from elf_eval.methods import Method

class Slow(Method):
    def __init__(self, spec, threads):
        self.folder, self.seconds = Path(spec.take("pids", str, "")), spec.take("seconds", float, 0.0)
        self.fingerprint = "slow"

    def extract(self, image, limit):
        (self.folder / str(os.getpid())).touch()
        end = time.monotonic() + self.seconds
        while time.monotonic() < end:  # at work, and not asleep
            pass
        points = [[20.0 + 7 * i, 30.0 + 5 * i] for i in range(10)]
        return LocalFeatures.build(points, range(10, 0, -1))
"""
PATIENCE = 10.0  # seconds until a process has to be gone


@pytest.fixture
def command(hpatches_folder, tmp_path):
    """The arguments of a run of two processes that need so many seconds for an image."""
    (tmp_path / "slow_method.py").write_text(PLUGIN)
    (tmp_path / "pids").mkdir()

    def of(seconds: float) -> list[str]:
        detector = f"plugin:slow_method.Slow?pids={tmp_path / 'pids'}&seconds={seconds}"
        where = ["--dataset", f"two=hpatches:{hpatches_folder}", "--out", str(tmp_path / "out"), "--quiet"]
        rest = ["--cache", str(tmp_path / "c"), "--workers", "2", "--threads", "1", "--size", "160x120"]
        return ["run", *where, "--detector", detector, *rest]

    return of


def start(arguments: list[str], folder: Path) -> subprocess.Popen[str]:
    path = os.pathsep.join([str(folder), *sys.path])
    return subprocess.Popen(
        [sys.executable, "-m", "elf_eval.cli", *arguments],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # Tests that were started in a shell's background ignore it, and so would what they start.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def alive(pid: int) -> bool:
    """Whether a process runs; one that only waits to be collected does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def workers_of(process: subprocess.Popen[str], folder: Path, count: int = 2) -> list[int]:
    """The workers' ids, once all are at work."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        found = [int(path.name) for path in folder.iterdir()]
        if len(found) == count:
            return found
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)
    raise AssertionError("the workers did not start")


def gone(pids: list[int]) -> bool:
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if not any(map(alive, pids)):
            return True
        time.sleep(0.05)
    return False


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc to look up processes in")


@needs_proc
@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_workers_end_with_their_parent(command, tmp_path, ending):
    with start(command(60.0), tmp_path) as process:
        pids = workers_of(process, tmp_path / "pids")
        process.send_signal(ending)
        assert gone([process.pid, *pids]), "still there"
        said = process.stderr.read()
        assert process.wait() == {signal.SIGKILL: -9, signal.SIGTERM: 143, signal.SIGINT: 130}[ending]
    assert "Traceback" not in said
    if ending == signal.SIGTERM:
        assert said.strip() == "elf-eval: terminated; the same command goes on from here"


TIMED = """
from pathlib import Path
from elf_eval.bench.method_process import MethodProcess
from elf_eval.data.images import ImageRef

if __name__ == "__main__":
    detector = "plugin:slow_method.Slow?pids={pids}&seconds=60"
    with MethodProcess(detector, None, ImageRef("photo.png", Path("{photo}")), None, 10, 1) as method:
        method.run()
"""


@needs_proc
def test_a_method_that_is_timed_ends_with_its_parent(command, photo_file, tmp_path):
    script = tmp_path / "timed.py"
    script.write_text(TIMED.format(pids=tmp_path / "pids", photo=photo_file))
    path = os.pathsep.join([str(tmp_path), *sys.path])
    with subprocess.Popen(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": path},
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        pids = workers_of(process, tmp_path / "pids", 1)
        process.kill()
        assert gone(pids), "still there"


@needs_proc
def test_what_was_finished_before_sigterm_is_kept(command, tmp_path):
    """Two of the features are made before the signal comes, and are not made again."""
    with start(command(0.5), tmp_path) as process:
        workers_of(process, tmp_path / "pids")
        while not (made := list((tmp_path / "c").rglob("[!.]*.npz"))):  # a dot: half-written
            time.sleep(0.02)
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 143
        process.stderr.read()
    times = {path: path.stat().st_mtime_ns for path in made}
    with start(command(0.5), tmp_path) as process:
        assert process.wait(60) == 0, process.stderr.read()
    assert {path: path.stat().st_mtime_ns for path in made} == times
    assert len(json.loads((tmp_path / "out" / "results.json").read_text())["pairs"]) == 4


def end_at_once(_: int) -> int:
    os._exit(7)


def test_a_worker_that_dies_is_one_line():
    with pytest.raises(EvalError, match="one of the 2 processes ended before its work was done"):
        list(run_all(end_at_once, [1, 2, 3], 2, 1))


def test_sigterm_s_handler_is_the_one_that_was_there(capsys):
    before = signal.getsignal(signal.SIGTERM)
    assert main(["list"]) == 0
    assert signal.getsignal(signal.SIGTERM) is before
