"""What `make release-check` finds in a wheel and a source archive; CI, hooks and pages name targets that there are."""

from __future__ import annotations

import io
import re
import runpy
import tarfile
import zipfile
from pathlib import Path
from typing import Any

import pytest

import elf_runtime
from helpers import ROOT

MODEL = "elf_runtime/models/elf-vgg-int8.onnx"
INFO = f"elf_onnx-{elf_runtime.__version__}.dist-info"
DEPENDENCIES = ["numpy>=1.24", "onnxruntime>=1.19", "opencv-python-headless>=4.10.0.84"]
COMMANDS = ["bench", "detect", "eval", "export", "info", "match"]


@pytest.fixture(scope="module")
def tool() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "tools" / "check_release.py"))


@pytest.fixture
def content(tool: dict[str, Any]) -> dict[str, str]:
    """Name and text of each file in a sound wheel; texts of the packages' own files do not matter."""
    lines = re.findall(r'^(elf-\w+ = )"(.+)"$', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    found = {name.split("/", 1)[1]: "" for name in tool["package_files"]()}
    found[f"{INFO}/METADATA"] = "".join(f"Requires-Dist: {text}\n" for text in DEPENDENCIES)
    found[f"{INFO}/entry_points.txt"] = "[console_scripts]\n" + "".join(f"{name}{main}\n" for name, main in lines)
    return found | {f"{INFO}/licenses/LICENSE": ""}


def faults(tool: dict[str, Any], content: dict[str, str], folder: Path) -> list[str]:
    wheel = folder / "a.whl"
    with zipfile.ZipFile(wheel, "w") as opened:
        for name, text in content.items():
            opened.writestr(name, text)
    found: list[str] = tool["faults_of_wheel"](wheel)
    return found


def test_a_sound_wheel(tool: dict[str, Any], content: dict[str, str], tmp_path: Path) -> None:
    assert {MODEL, "elf_eval/py.typed", "elf_export/py.typed", "elf_runtime/py.typed"} <= set(content)
    assert faults(tool, content, tmp_path) == []


@pytest.mark.parametrize("name", [MODEL, "elf_runtime/py.typed", "elf_export/calibration_images/README.md"])
def test_a_file_that_is_missing(tool: dict[str, Any], content: dict[str, str], name: str, tmp_path: Path) -> None:
    del content[name]
    assert faults(tool, content, tmp_path) == [f"a.whl lacks {name}"]


def test_what_does_not_belong(tool: dict[str, Any], content: dict[str, str], tmp_path: Path) -> None:
    content["tests/helpers.py"] = ""
    del content[f"{INFO}/licenses/LICENSE"]
    assert faults(tool, content, tmp_path) == [
        "a.whl has tests/helpers.py, which is no file of the packages",
        "a.whl lacks the licence",
    ]


def test_dependencies_of_the_builders_own_environment(
    tool: dict[str, Any], content: dict[str, str], tmp_path: Path
) -> None:
    metadata = f"{INFO}/METADATA"
    content[metadata] = content[metadata].replace("opencv-python-headless", "opencv-python")
    (fault,) = faults(tool, content, tmp_path)
    assert fault.startswith("a.whl does not ask for opencv-python-headless>=4.10.0.84")


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_is_missing(tool: dict[str, Any], content: dict[str, str], command: str, tmp_path: Path) -> None:
    points = f"{INFO}/entry_points.txt"
    content[points] = re.sub(rf"^elf-{command} = .*\n", "", content[points], flags=re.MULTILINE)
    (fault,) = faults(tool, content, tmp_path)
    assert fault.startswith(f"a.whl lacks the command elf-{command} = ")


def test_an_archive_must_hold_what_a_wheel_is_built_from(tool: dict[str, Any], tmp_path: Path) -> None:
    archive = tmp_path / "a.tar.gz"
    names = tool["package_files"]() | tool["BUILT_FROM"]
    with tarfile.open(archive, "w:gz") as opened:
        for name in sorted(names - {"tools/dependencies.py", f"runtime/{MODEL}"}):
            opened.addfile(tarfile.TarInfo(f"elf_onnx-1/{name}"), io.BytesIO())
    assert tool["faults_of_archive"](archive) == [
        f"a.tar.gz lacks runtime/{MODEL}",
        "a.tar.gz lacks tools/dependencies.py",
    ]


def test_no_archives(tool: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tool["main"](tmp_path) == 1
    assert capsys.readouterr().out.count("is missing") == 2


def test_targets_of_make_exist() -> None:
    """Those that the documents, the CI file and the hooks name."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))
    (phony,) = re.findall(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)
    assert targets == set(phony.split())
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    in_ci = set(re.findall(r"target: \[?([a-z-]+)", workflow))
    assert in_ci == {
        "test-runtime",
        "test-lowest",
        "test-newest",
        "test-full",
        "lint",
        "docs",
        "demo",
        "release-check",
    }
    named = set(in_ci)
    for file in (
        ROOT / ".pre-commit-config.yaml",
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/*.md"),
        *ROOT.glob("m*/*.md"),
    ):
        named |= set(re.findall(r"(?:^    |`|entry: )make ([a-z-]+)", file.read_text(encoding="utf-8"), re.MULTILINE))
    assert named <= targets


def test_every_supported_python_is_tested() -> None:
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    (listed,) = re.findall(r"python: \[(.*)\]", workflow)
    pyproject = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    stated = re.findall(r"Programming Language :: Python :: (3\.\d+)", pyproject)
    assert re.findall(r"[\d.]+", listed) == stated
    assert f'requires-python = ">={stated[0]}"' in pyproject
