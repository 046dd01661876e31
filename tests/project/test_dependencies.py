"""What `pip install .` asks for, by what is installed already; and the lowest versions."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
import types
import venv
from pathlib import Path
from typing import Any

import pytest

from helpers import ROOT

DECLARED = ["numpy>=1.24", "onnxruntime>=1.19", "opencv-python-headless>=4.10.0.84"]


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """tools/dependencies.py, with a stand-in for hatchling, which calls it."""
    for name in ("hatchling", "hatchling.metadata", "hatchling.metadata.plugin"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    interface = types.ModuleType("interface")
    interface.MetadataHookInterface = object  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "hatchling.metadata.plugin.interface", interface)
    return runpy.run_path(str(ROOT / "tools" / "dependencies.py"))


def install(folder: Path, name: str, *files: str, version: str = "9.9") -> None:
    """A package as pip leaves it: its files, and its record of them."""
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n", encoding="utf-8")
    (info / "RECORD").write_text("".join(f"{file},,\n" for file in files), encoding="utf-8")
    for file in files:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).touch()


@pytest.mark.parametrize(
    ("installed", "wanted"),
    [
        ({}, DECLARED),
        ({"opencv-python-headless": ["cv2/__init__.py"], "onnxruntime": ["onnxruntime/__init__.py"]}, DECLARED),
        ({"opencv-python": ["cv2/__init__.py"]}, [*DECLARED[:2], "opencv-python>=4.10.0.84"]),
        ({"opencv_contrib_python": ["cv2/__init__.py"]}, [*DECLARED[:2], "opencv-contrib-python>=4.10.0.84"]),
        ({"opencv-contrib-python-headless": ["cv2/__init__.py"], "onnxruntime-gpu": ["onnxruntime/capi/a.so"]},
         [DECLARED[0], "onnxruntime-gpu>=1.19", "opencv-contrib-python-headless>=4.10.0.84"]),
        # Both of one kind: the usual one is asked for, which is there.
        ({"opencv-python": ["cv2/a.so"], "opencv-python-headless": ["cv2/a.so"]}, DECLARED),
        ({"onnxruntime-openvino": ["onnxruntime/__init__.py"]},
         [DECLARED[0], "onnxruntime-openvino>=1.19", DECLARED[2]]),
        # Of like names, and no builds of these libraries.
        ({"onnxruntime-extensions": ["onnxruntime_extensions/a.py"], "opencv-stubs": ["cv2-stubs/a.pyi"]}, DECLARED),
        # Not from pip: Debian's python3-opencv, a build from source, a nightly build of another name.
        ({"": ["cv2.cpython-311-x86_64-linux-gnu.so"]}, DECLARED[:2]),
        ({"": ["cv2/__init__.py"]}, DECLARED[:2]),
        ({"ort-nightly": ["onnxruntime/__init__.py"]}, [DECLARED[0], DECLARED[2]]),
        # What a removed package left behind is no build.
        ({"": ["cv2/__pycache__/a.pyc", "onnxruntime/capi/a.log"]}, DECLARED),
    ],
)  # fmt: skip
def test_a_build_that_is_installed_is_asked_for(
    tool: dict[str, Any], tmp_path: Path, installed: dict[str, list[str]], wanted: list[str]
) -> None:
    (tmp_path / "lib").mkdir()
    for name, files in installed.items():
        if name:
            install(tmp_path / "lib", name, *files)
        for file in files:
            (tmp_path / "lib" / file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / "lib" / file).touch()
    assert tool["suited"](DECLARED, [str(tmp_path / "absent"), str(tmp_path / "lib")]) == wanted


def test_the_lowest_versions_are_those_that_are_declared() -> None:
    """Of the base and of the extra that `make test-lowest` installs."""
    pyproject = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    declared = dict(re.findall(r'"([\w-]+)>=([\d.]+)"', pyproject.replace("; python_version<'3.11'", "")))
    lowest = dict(re.findall(r"^([\w-]+)==([\d.]+);", (ROOT / "constraints-lowest.txt").read_text("utf-8"), re.M))
    base = [re.split(">=", text)[0] for text in DECLARED]
    assert set(lowest) == {*base, "h5py", "matplotlib"}
    padded = {name: version.split(".") for name, version in lowest.items()}
    assert padded == {name: (declared[name].split(".") + ["0"] * 3)[: len(padded[name])] for name in lowest}
    assert [f"{name}>={declared[name]}" for name in base] == DECLARED


@pytest.mark.network
def test_pip_leaves_the_installed_builds_alone(tmp_path: Path) -> None:
    """pip itself, in an environment that has an OpenCV with windows and an ONNX Runtime with an accelerator."""
    venv.create(tmp_path / "env", with_pip=True)
    (folder,) = (tmp_path / "env").glob("lib/python*/site-packages")
    for name, module in (("opencv-contrib-python", "cv2"), ("onnxruntime-openvino", "onnxruntime"), ("numpy", "numpy")):
        install(folder, name, f"{module}/__init__.py")
    report = tmp_path / "report.json"
    done = subprocess.run(
        [*map(str, (tmp_path / "env" / "bin" / "python", "-m", "pip", "install", "--dry-run", "--report", report)),
         "--quiet", "--disable-pip-version-check", str(ROOT)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode and "hatchling" in done.stderr:
        pytest.skip("no package index has hatchling, which builds the package")
    assert done.returncode == 0, done.stderr
    (only,) = json.loads(report.read_text(encoding="utf-8"))["install"]
    assert only["metadata"]["requires_dist"][:3] == [
        "numpy>=1.24", "onnxruntime-openvino>=1.19", "opencv-contrib-python>=4.10.0.84"
    ]  # fmt: skip
