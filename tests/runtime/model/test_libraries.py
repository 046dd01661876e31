"""What the import says where OpenCV or ONNX Runtime is missing, and what ONNX Runtime sends: nothing."""

from __future__ import annotations

import ast
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import onnxruntime
import pytest

from helpers import ROOT

PACKAGES = [str(ROOT / name) for name in ("runtime", "evaluation", "export")]
HEADLESS = "pip install opencv-python-headless, or opencv-python where its windows are wanted"
ONNXRUNTIME = "pip install onnxruntime, or the build for your device, such as onnxruntime-gpu or onnxruntime-openvino"
SENDS = tuple(map(int, onnxruntime.__version__.split(".")[:2])) >= (1, 29)


def environment(home: Path, *first: Path, **more: str) -> dict[str, str]:
    """Of a user who has said nothing on telemetry: ONNX Runtime sends nothing in continuous integration."""
    dropped = ("CI", "GITHUB_ACTIONS", "TF_BUILD", "ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME", "XDG_STATE_HOME")
    kept = {name: value for name, value in os.environ.items() if name not in dropped}
    return kept | {"HOME": str(home), "PYTHONPATH": os.pathsep.join([*map(str, first), *PACKAGES]), **more}


def python(script: str, env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, env=env)


@pytest.mark.parametrize(
    ("module", "content", "said"),
    [
        ("cv2", "raise ModuleNotFoundError(\"No module named 'cv2'\", name='cv2')",
         f"OpenCV (cv2), which is not installed: {HEADLESS}"),
        ("onnxruntime", "raise ModuleNotFoundError(\"No module named 'onnxruntime'\", name='onnxruntime')",
         f"ONNX Runtime (onnxruntime), which is not installed: {ONNXRUNTIME}"),
        ("cv2", "raise ImportError('libGL.so.1: cannot open shared object file')",
         "OpenCV (cv2), which is installed but can't be loaded (libGL.so.1: cannot open shared object file): "
         + HEADLESS.replace("install", "install --force-reinstall")),
        ("cv2", "cv2 = __import__('cv2').gapi_wip_gst_GStreamerPipeline",
         "OpenCV (cv2), which is installed but can't be loaded (partially initialized module 'cv2' has no attribute "
         "'gapi_wip_gst_GStreamerPipeline' (most likely due to a circular import)): "
         + HEADLESS.replace("install", "install --force-reinstall")),
        ("onnxruntime", "import absent_module",
         "ONNX Runtime (onnxruntime), which is installed but can't be loaded (No module named 'absent_module'): "
         + ONNXRUNTIME.replace("install", "install --force-reinstall")),
        ("cv2", "", "OpenCV (cv2), which is installed in parts only, as when one of two builds was removed: "
         + HEADLESS.replace("install", "install --force-reinstall")),
        ("onnxruntime", "", "ONNX Runtime (onnxruntime), which is installed in parts only, as when one of two builds "
         "was removed: " + ONNXRUNTIME.replace("install", "install --force-reinstall")),
    ],
)  # fmt: skip
@pytest.mark.parametrize("package", ["elf_runtime", "elf_eval", "elf_export"])
def test_a_missing_library_is_named_with_what_to_install(
    tmp_path: Path, package: str, module: str, content: str, said: str
) -> None:
    (tmp_path / f"{module}.py").write_text(content, encoding="utf-8")
    done = python(f"import {package}", environment(tmp_path, tmp_path))
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1].replace(f" from '{tmp_path / module}.py'", "")  # Python 3.13 names the file
    assert last == f"ImportError: elf_runtime needs {said}"
    assert "During handling" not in done.stderr  # one error, not a chain of them


NAMED = (
    'named networks need PyTorch and onnx: pip install torch (the CPU build is enough), then pip install ".[export]"'
)


@pytest.mark.parametrize(
    ("options", "content", "said"),
    [
        ("--onnx a.onnx --list", None, "elf-export --onnx needs the package onnx, and no PyTorch: pip install onnx"),
        ("--net vgg --layer pool1", None, NAMED),
        ("--list", None, NAMED),
        ("--onnx a.onnx --list", "raise ImportError('protobuf is too old')",
         "the package onnx is installed but can't be loaded: protobuf is too old"),
    ],
)  # fmt: skip
def test_the_exporter_asks_for_no_more_than_it_needs(
    tmp_path: Path, options: str, content: str | None, said: str
) -> None:
    absent = "raise ModuleNotFoundError(\"No module named '{0}'\", name='{0}')"
    (tmp_path / "onnx.py").write_text(absent.format("onnx") if content is None else content, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "elf_export.cli", *options.split()],
        capture_output=True, text=True, check=False, env=environment(tmp_path, tmp_path),
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (1, f"elf-export: error: {said}\n")


@pytest.mark.parametrize("package", ["elf_runtime", "elf_eval", "elf_export"])
@pytest.mark.parametrize(
    ("given", "loaded_with", "asked"),
    [(None, "1", True), ("", "1", True), ("1", "1", True), ("0", "0", False), ("False", "False", False)],
)
def test_telemetry_is_off_before_onnxruntime_is_loaded(
    tmp_path: Path, package: str, given: str | None, loaded_with: str, asked: bool
) -> None:
    """A stand-in for ONNX Runtime tells what it saw."""
    (tmp_path / "onnxruntime.py").write_text(
        "import os\nclass InferenceSession: ...\nprint('loaded with', os.environ.get('ORT_DISABLE_TELEMETRY'))\n"
        "def disable_telemetry_events(): print('asked')\ndef __getattr__(name): raise ImportError('enough')\n",
        encoding="utf-8",
    )
    more = {} if given is None else {"ORT_DISABLE_TELEMETRY": given}
    done = python(f"import {package}", environment(tmp_path, tmp_path, **more))
    assert done.stdout.split("\n")[:-1] == [f"loaded with {loaded_with}"] + ["asked"] * asked


DETECT = """
import sys, time
{ban}
import numpy as np
from elf_runtime import ElfRuntime
assert len(ElfRuntime(threads=1).detect(np.random.default_rng(0).integers(0, 256, (64, 96, 3), np.uint8)))
print("detected", flush=True)
sys.stdin.read()
"""
# From here on the kernel ends the process (SIGSYS) that opens a socket.  BPF: load the system call's number; if it is
# socket's, kill, else allow.
BAN = """
import ctypes, platform, struct
number = {"x86_64": 41, "aarch64": 198}[platform.machine()]
rows = [(0x20, 0, 0, 0), (0x15, 0, 1, number), (0x06, 0, 0, 0x80000000), (0x06, 0, 0, 0x7FFF0000)]
code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *row) for row in rows))
program = ctypes.create_string_buffer(struct.pack("HxxxxxxP", len(rows), ctypes.addressof(code)))
libc = ctypes.CDLL(None, use_errno=True)
assert libc.prctl(38, 1, 0, 0, 0) == 0 and libc.prctl(22, 2, program, 0, 0) == 0, ctypes.get_errno()
"""


def files_below(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


@pytest.fixture
def detecting(tmp_path: Path) -> Iterator[dict[str, subprocess.Popen[str]]]:
    """Two processes that detect and stay: of a user who has said nothing, and of one who wants telemetry."""
    running = {}
    for name, more in (("silent", {}), ("sending", {"ORT_DISABLE_TELEMETRY": "0"})):
        home = tmp_path / name
        home.mkdir()
        running[name] = subprocess.Popen(
            [sys.executable, "-c", DETECT.format(ban=BAN)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True, env=environment(home, **more),
        )  # fmt: skip
    yield running
    for process in running.values():
        process.kill()
        process.communicate()


@pytest.mark.skipif(sys.platform != "linux", reason="the ban on sockets is Linux's")
def test_no_file_is_written_and_no_socket_opened(detecting: dict[str, subprocess.Popen[str]], tmp_path: Path) -> None:
    """The process that sends shows how long to wait, and that the ban and the look at the files find something."""
    silent, sending = detecting["silent"], detecting["sending"]
    assert silent.stdout is not None
    assert silent.stdout.readline() == "detected\n"
    if SENDS:
        assert sending.wait(timeout=60) == -signal.SIGSYS
        assert files_below(tmp_path / "sending")
        time.sleep(2)
    assert silent.poll() is None
    assert files_below(tmp_path / "silent") == []
    assert silent.communicate("", timeout=20) == ("", "")  # nothing at the end either
    assert silent.returncode == 0
    assert files_below(tmp_path / "silent") == []


def test_a_user_who_imported_onnxruntime_first_gets_what_its_interface_can_do(tmp_path: Path) -> None:
    script = (
        "import onnxruntime\ncalls = []\nonnxruntime.disable_telemetry_events = lambda: calls.append(1)\n"
        "import elf_runtime\nprint(calls)"
    )
    assert python(script, environment(tmp_path)).stdout == "[1]\n"


def imports_in_order(source: str) -> list[str]:
    """The top-level packages that a script imports, in the order of its lines."""
    found = []
    for node in ast.walk(ast.parse(source)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
        found += [(node.lineno, name.split(".")[0]) for name in names]
    return [name for _, name in sorted(found)]


def scripts() -> Iterator[tuple[str, str]]:
    """What runs outside the three packages: name, source."""
    for folder in ("benchmarks", "demo", "examples", "tools"):
        for path in (ROOT / folder).rglob("*.py"):
            yield str(path), path.read_text(encoding="utf-8")
    for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("e*/*.md"), *ROOT.glob("models/*.md")):
        for block in re.findall(r"^```python\n(.*?)^```", path.read_text(encoding="utf-8"), re.M | re.S):
            yield str(path), block


def test_scripts_and_pages_import_a_package_of_ours_before_onnxruntime() -> None:
    """Or set the variable themselves."""
    late = []
    for name, source in scripts():
        order = imports_in_order(source)
        ours = [i for i, module in enumerate(order) if module.startswith("elf_")]
        if "onnxruntime" not in order or "ORT_DISABLE_TELEMETRY" in source:
            continue
        if not ours or ours[0] > order.index("onnxruntime"):
            late.append(name)
    assert late == []
