"""The runtime never loads torch or onnx, and starts quickly enough to say so by its imports alone."""

from __future__ import annotations

import subprocess
import sys

from helpers import ROOT

FORBIDDEN = ("torch", "onnx", "onnxscript", "elf_export", "h5py", "pycolmap", "scipy", "matplotlib")

DETECT = """
import sys
import numpy as np
import elf_runtime
from elf_runtime.commands import bench, detect, info, localize, match, reconstruct
elf = elf_runtime.ElfRuntime()
found = elf.detect(np.random.default_rng(0).integers(0, 256, (64, 96, 3), np.uint8))
assert len(found.descriptors) == len(found)
print([name for name in {forbidden!r} if name in sys.modules])
"""


def run(*args: str) -> subprocess.CompletedProcess[str]:
    env_path = f"{ROOT / 'runtime'}"
    return subprocess.run(
        [sys.executable, *args], capture_output=True, text=True, check=True, env={"PYTHONPATH": env_path, "PATH": ""}
    )


def test_detection_loads_neither_torch_nor_onnx() -> None:
    assert run("-c", DETECT.format(forbidden=FORBIDDEN)).stdout.strip() == "[]"


def test_importtime_shows_neither() -> None:
    trace = run("-X", "importtime", "-c", "import elf_runtime; elf_runtime.ElfRuntime()").stderr
    modules = {line.rsplit("|", 1)[-1].strip() for line in trace.splitlines()}
    assert "elf_runtime.engine" in modules
    assert not {name for name in modules if name.split(".")[0] in FORBIDDEN}
