"""A model that is open when a process forks works in the child, on ever new sizes, and lets the child end."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from helpers import ROOT

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")

PARENT = """
import os, sys, threading, time
import numpy as np
from elf_runtime import ElfRuntime

rng = np.random.default_rng(0)
pictures = [rng.integers(0, 256, (side, side + 8, 3), np.uint8) for side in (64, 80, 96, 112, 128, 144)]
elf = ElfRuntime(threads=2)
wanted = [elf.detect(picture).keypoints for picture in pictures]
for picture in pictures[:2]:  # what the child inherits: sessions for sizes of their own, in use
    elf.detect(picture), elf.detect(picture), elf.saliency(picture)
"""

CHILD = """
def work():
    for _ in range(2):
        found = [elf.detect(picture).keypoints for picture in pictures[::-1]][::-1]
        elf.saliency(pictures[3]), elf.describe(pictures[4], [(20.0, 20.0)])
    assert all(np.allclose(a, b, atol=1e-3) for a, b in zip(found, wanted))
    ElfRuntime(threads=2).detect(pictures[5])
"""

WAYS = {
    # The interpreter's end destroys whatever is left.
    "os.fork, and the child's end": """
child = os.fork()
work()
if child == 0:
    del elf
    sys.exit(0)
assert os.waitpid(child, 0)[1] == 0
""",
    "multiprocessing, daemon": """
import multiprocessing
child = multiprocessing.get_context("fork").Process(target=work, daemon=True)
child.start(), child.join()
assert child.exitcode == 0
""",
    "a child's child": """
child = os.fork()
if child == 0:
    work()
    grandchild = os.fork()
    work()
    sys.exit(os.waitpid(grandchild, 0)[1] if grandchild else 0)
assert os.waitpid(child, 0)[1] == 0
""",
    "while other threads detect and open sessions": """
def busy(seed):
    local = np.random.default_rng(seed)
    while not done:
        side = int(local.integers(40, 90))
        elf.detect(local.integers(0, 256, (side, side, 3), np.uint8))
        ElfRuntime(threads=2)

done = False
threads = [threading.Thread(target=busy, args=(seed,), daemon=True) for seed in range(2)]
[thread.start() for thread in threads]
for _ in range(4):
    time.sleep(0.05)
    child = os.fork()
    if child == 0:
        work()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
done = True
[thread.join() for thread in threads]
""",
}


@pytest.mark.parametrize("way", WAYS)
def test_forked_child_detects_as_its_parent_does(way: str) -> None:
    env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime"), "PYTHONWARNINGS": "ignore::DeprecationWarning"}
    script = PARENT + CHILD + WAYS[way]
    done = subprocess.run(
        [sys.executable, "-c", script], env=env, capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stderr
