"""The lean wheel: what it leaves out, and that pip installs it and it detects."""

from __future__ import annotations

import base64
import hashlib
import os
import runpy
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import elf_runtime
from elf_runtime.model import bundled_model
from helpers import ROOT

VERSION = elf_runtime.__version__
WHOLE = f"elf_onnx-{VERSION}.dist-info"
LEAN = f"elf_onnx-{VERSION}+lean.dist-info"
METADATA = f"""Metadata-Version: 2.4
Name: elf-onnx
Version: {VERSION}
Requires-Dist: numpy>=1.24
Provides-Extra: dev
Requires-Dist: torch>=2.6; extra == 'dev'
Provides-Extra: eval
Requires-Dist: tomli>=2; (python_version < '3.11') and extra == 'eval'
Provides-Extra: export
Requires-Dist: torch>=2.6; extra == "export"
Provides-Extra: sfm
Requires-Dist: pycolmap>=4.0; extra == 'sfm'

# elf-onnx

Provides-Extra: dev
"""
LEAN_METADATA = f"""Metadata-Version: 2.4
Name: elf-onnx
Version: {VERSION}+lean
Requires-Dist: numpy>=1.24
Provides-Extra: sfm
Requires-Dist: pycolmap>=4.0; extra == 'sfm'

# elf-onnx

Provides-Extra: dev
"""
POINTS = """[console_scripts]
elf-detect = elf_runtime.commands.detect:main
elf-eval = elf_eval.cli:main
elf-export = elf_export.cli:main

[pyinstaller40]
hook-dirs = elf_runtime.__pyinstaller:get_hook_dirs
"""


def lean(folder: Path, **options: bool) -> Path:
    """The lean wheel of a whole one with the checkout's files."""
    whole = folder / f"elf_onnx-{VERSION}-py3-none-any.whl"
    with zipfile.ZipFile(whole, "w") as opened:
        for room in ("export/elf_export", "runtime/elf_runtime", "evaluation/elf_eval"):
            for path in (ROOT / room).rglob("*"):
                if path.is_file() and path.parent.name != "__pycache__":
                    opened.write(path, path.relative_to((ROOT / room).parent))
        opened.writestr(f"{WHOLE}/METADATA", METADATA)
        opened.writestr(f"{WHOLE}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        opened.writestr(f"{WHOLE}/entry_points.txt", POINTS)
        opened.writestr(f"{WHOLE}/licenses/LICENSE", "a licence")
        opened.writestr(f"{WHOLE}/RECORD", "")
    made: Path = runpy.run_path(str(ROOT / "tools" / "lean_wheel.py"))["lean_wheel"](whole, folder / "lean", **options)
    return made


def test_it_holds_the_runtime_and_the_int8_model(tmp_path: Path) -> None:
    made = lean(tmp_path)
    assert made == tmp_path / "lean" / f"elf_onnx-{VERSION}+lean-py3-none-any.whl"
    with zipfile.ZipFile(made) as opened:
        names = set(opened.namelist())
        assert opened.read(f"{LEAN}/METADATA").decode() == LEAN_METADATA
        assert opened.read(f"{LEAN}/entry_points.txt").decode() == POINTS.replace(
            "elf-eval = elf_eval.cli:main\nelf-export = elf_export.cli:main\n", ""
        )
    runtime = ROOT / "runtime"
    files = {p for p in (runtime / "elf_runtime").rglob("*") if p.is_file() and p.parent.name != "__pycache__"}
    expected = {path.relative_to(runtime).as_posix() for path in files - {bundled_model("fp32")}}
    assert names == expected | {
        f"{LEAN}/{name}" for name in ("METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE")
    }


def test_its_record_names_every_file_with_its_hash(tmp_path: Path) -> None:
    with zipfile.ZipFile(lean(tmp_path)) as opened:
        rows = dict(line.split(",", 1) for line in opened.read(f"{LEAN}/RECORD").decode().splitlines())
        assert list(rows) == opened.namelist()
        assert rows.pop(f"{LEAN}/RECORD") == ","
        for name, row in rows.items():
            data = opened.read(name)
            digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")
            assert row == f"sha256={digest},{len(data)}"


def test_fp32_stays_on_request(tmp_path: Path) -> None:
    with zipfile.ZipFile(lean(tmp_path, fp32=True)) as opened:
        assert opened.read("elf_runtime/models/elf-vgg.onnx") == bundled_model("fp32").read_bytes()


def test_pip_installs_it_and_it_detects(tmp_path: Path) -> None:
    pytest.importorskip("pip", reason="this environment has no pip")
    made, target = lean(tmp_path), tmp_path / "installed"
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*pip, "--target", str(target), str(made)], check=True)
    assert (target / "bin" / "elf-detect").is_file() or os.name == "nt"
    assert not (target / "bin" / "elf-export").exists()

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONPATH": str(target), "OMP_NUM_THREADS": "1"}
        return subprocess.run(
            [sys.executable, *words], cwd=tmp_path, env=environment, check=False, text=True, capture_output=True
        )

    detected = run("-m", "elf_runtime.commands.detect", str(ROOT / "demo" / "palace.jpg"), "-o", "out")
    assert ": 500 keypoints" in detected.stdout, detected.stderr
    where = run("-c", "import elf_runtime; print(elf_runtime.__file__)")
    assert Path(where.stdout.strip()).is_relative_to(target)
    missing = run("-c", "from elf_runtime.model import bundled_model; bundled_model('fp32')")
    assert "elf-vgg.onnx is missing" in missing.stderr
    assert "The lean wheel has the one in int8 alone." in missing.stderr
    few = ["--sizes", "64x64", "--repeats", "1", "--warmup", "1", "--processes", "1", "--threads", "1"]
    assert run("-m", "elf_runtime.commands.bench", *few).returncode == 0  # without its peer torch
    asked = run("-m", "elf_runtime.commands.bench", *few, "--peers", "torch")
    assert asked.returncode == 1
    assert "elf-vgg.onnx is missing" in asked.stderr
