"""The program of examples/cpp, compiled against the library that Python runs, and what it prints."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnxruntime as ort
import pytest

from elf_runtime import ModelContract
from elf_runtime.model import bundled_model
from project.example_inputs import EXAMPLES

Rows = npt.NDArray[np.float32]
HEADER = "onnxruntime_cxx_api.h"


def run(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)


def headers() -> Path:
    """The folder of the C++ headers; skips where there is none, or the library of the wheel is older."""
    for tool in ("cmake", "c++", "pkg-config"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    if run("pkg-config", "opencv4").returncode:
        pytest.skip("OpenCV's C++ headers are not installed (libopencv-dev)")
    given, system = os.environ.get("ELF_ORT"), run("pkg-config", "--variable=includedir", "libonnxruntime").stdout
    found = sorted(Path(given, "include").rglob(HEADER)) if given else sorted(Path(system.strip() or "/").glob(HEADER))
    if not found:
        pytest.skip("ONNX Runtime's C++ headers are not installed (libonnxruntime-dev, or name them in $ELF_ORT)")
    api = re.search(r"^#define ORT_API_VERSION (\d+)", (found[0].parent / "onnxruntime_c_api.h").read_text(), re.M)
    if api is None or int(api[1]) > int(ort.__version__.split(".")[1]):
        pytest.skip(f"ONNX Runtime's headers are newer than the library {ort.__version__}")
    return found[0].parent


def compiled(folder: Path) -> Path:
    """The example, compiled in `folder`; skips where something that it takes is not installed."""
    (folder / "ort" / "lib").mkdir(parents=True)
    (folder / "ort" / "include").symlink_to(headers(), target_is_directory=True)
    libraries = sorted((Path(ort.__file__).parent / "capi").glob("libonnxruntime.so.*"))
    if not libraries:
        pytest.skip("onnxruntime's wheel has no libonnxruntime.so here")
    for name in ("libonnxruntime.so", "libonnxruntime.so.1"):
        (folder / "ort" / "lib" / name).symlink_to(libraries[0])
    flags = "-DCMAKE_CXX_FLAGS=-Wall -Wextra -Werror"
    made = run("cmake", "-S", EXAMPLES / "cpp", "-B", folder / "build", f"-DORT={folder / 'ort'}", flags)
    assert made.returncode == 0, made.stderr
    made = run("cmake", "--build", folder / "build")
    assert made.returncode == 0, made.stdout + made.stderr
    return folder / "build" / "elf"


def end_to_end_model(path: Path, precision: str = "fp32", **form: Any) -> Path:
    """A bundled model as an end-to-end file of this `Form`."""
    onnx = pytest.importorskip("onnx")
    from elf_export.end_to_end.build import Form, end_to_end

    model = onnx.load(bundled_model(precision))
    contract = ModelContract.from_metadata({entry.key: entry.value for entry in model.metadata_props}, "it")
    onnx.save(end_to_end(model, contract, Form(**form)), path)
    return path


def printed(*command: str | Path) -> Rows:
    done = run(*command)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return np.array([line.split() for line in done.stdout.splitlines()], np.float32)
