"""The bundled model is found wherever Python can import the package from."""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
import types
import zipfile
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from elf_runtime import ElfRuntime, ModelError, match
from elf_runtime.model import bundled
from elf_runtime.model.bundled import BUNDLED, bundled_model, read_bundled
from helpers import ROOT, textured

RUNTIME = ROOT / "runtime" / "elf_runtime"
PICTURE = textured(64, 96)
DETECT = """
import json, os, sys
import numpy as np
from pathlib import Path
from elf_runtime import ElfRuntime
from elf_runtime.model.bundled import bundled_model
found = ElfRuntime(threads=1).detect(np.load(sys.argv[1]))
path = bundled_model("fp32")
if (child := os.fork()) == 0:
    sys.exit()  # a child's end leaves the copy where it is
os.waitpid(child, 0)
print(json.dumps([len(found), str(path), path.stat().st_size]))
"""
# An importer as some frozen programs have it: modules from memory, no resources, no __file__, data by get_data alone.
FROZEN = """
import importlib.abc, importlib.util, os, sys, zipfile
ARCHIVE = zipfile.ZipFile(sys.argv[2])

class Frozen(importlib.abc.MetaPathFinder, importlib.abc.InspectLoader):
    def find_spec(self, name, path=None, target=None):
        for inside in (name.replace(".", "/") + "/__init__.py", name.replace(".", "/") + ".py"):
            if inside in ARCHIVE.namelist():
                package = inside.endswith("__init__.py")
                return importlib.util.spec_from_loader(name, self, is_package=package, origin="/frozen/" + inside)
        return None
    def get_source(self, name):
        spec = self.find_spec(name)
        return ARCHIVE.read(spec.origin.removeprefix("/frozen/")).decode()
    def exec_module(self, module):
        module.__file__ = module.__spec__.origin
        super().exec_module(module)
    def get_data(self, path):
        try:
            return ARCHIVE.read(str(path).replace(os.sep, "/").removeprefix("/frozen/"))
        except KeyError as error:
            raise OSError(str(error)) from error

sys.meta_path.insert(0, Frozen())
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("archive") / "elf.zip"
    with zipfile.ZipFile(path, "w") as file:
        for part in RUNTIME.rglob("*"):
            if part.suffix in (".py", ".onnx"):
                file.write(part, part.relative_to(RUNTIME.parent))
    return path


def detected(script: str, archive: Path, tmp_path: Path, path: str) -> subprocess.CompletedProcess[str]:
    np.save(tmp_path / "picture.npy", PICTURE)
    (tmp_path / "tmp").mkdir()
    env = os.environ | {"PYTHONPATH": path, "TMPDIR": str(tmp_path / "tmp")}
    return subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "picture.npy"), str(archive)],
        capture_output=True, text=True, check=False, env=env, cwd=tmp_path,
    )  # fmt: skip


@pytest.mark.parametrize("way", ["zip", "frozen"])
def test_it_is_found_in_an_archive(archive: Path, tmp_path: Path, way: str) -> None:
    script, path = (DETECT, str(archive)) if way == "zip" else (FROZEN + DETECT, "")
    done = detected(script, archive, tmp_path, path)
    assert done.returncode == 0, done.stderr
    count, copy, size = json.loads(done.stdout)
    assert count == len(ElfRuntime(threads=1).detect(PICTURE)) > 0
    assert size == bundled_model("fp32").stat().st_size
    assert Path(copy).is_relative_to(tmp_path / "tmp")
    assert list((tmp_path / "tmp").iterdir()) == []  # the copy is removed at the end


def test_an_error_names_the_archive(archive: Path, tmp_path: Path) -> None:
    script = "from elf_runtime import ElfRuntime; print(repr(ElfRuntime()))"
    done = detected(script, archive, tmp_path, str(archive))
    assert f"{archive}/elf_runtime/models/{BUNDLED['int8']}" in done.stdout
    assert list((tmp_path / "tmp").iterdir()) == []  # detection needs no copy


@pytest.mark.parametrize("script", [DETECT, FROZEN + DETECT])
def test_a_program_packed_without_it_says_what_to_do(tmp_path: Path, script: str) -> None:
    empty = tmp_path / "empty.zip"
    with zipfile.ZipFile(empty, "w") as file:
        for part in RUNTIME.rglob("*.py"):
            file.write(part, part.relative_to(RUNTIME.parent))
    done = detected(script, empty, tmp_path, str(empty) if script == DETECT else "")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        f"elf_runtime.errors.ModelError: the bundled model {BUNDLED['int8']} is missing where elf_runtime is imported "
        "from. If this program was frozen or packed, put the package's data files into it (PyInstaller: "
        "--collect-data elf_runtime), or give ElfRuntime a model file"
    )


@pytest.mark.parametrize("precision", BUNDLED)
def test_of_a_checkout_it_is_the_file_itself(precision: str) -> None:
    path = RUNTIME / "models" / BUNDLED[precision]
    assert bundled_model(precision) == path
    assert read_bundled(precision) == (path.read_bytes(), str(path))


def test_a_missing_file_is_an_error_of_the_path_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BUNDLED, "fp32", "absent.onnx")
    with pytest.raises(ModelError, match=r"the bundled model absent\.onnx is missing"):
        bundled_model("fp32")
    assert "absent.onnx" not in bundled._paths


def test_pyinstaller_is_told_of_the_data(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in for PyInstaller, which asks the entry point for folders and runs the hook of a package there."""
    entry = next((e for e in metadata.entry_points(group="pyinstaller40") if e.value.startswith("elf_runtime.")), None)
    declared = 'hook-dirs = "elf_runtime.__pyinstaller:get_hook_dirs"'
    assert declared in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert entry is None or entry.value == "elf_runtime.__pyinstaller:get_hook_dirs"
    hooks = types.ModuleType("PyInstaller.utils.hooks")
    hooks.collect_data_files = lambda package: [f"data of {package}"]  # type: ignore[attr-defined]
    hooks.collect_submodules = lambda package: [f"modules of {package}"]  # type: ignore[attr-defined]
    for name in ("PyInstaller", "PyInstaller.utils"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    monkeypatch.setitem(sys.modules, "PyInstaller.utils.hooks", hooks)
    from elf_runtime.__pyinstaller import get_hook_dirs

    (folder,) = map(Path, get_hook_dirs())
    assert runpy.run_path(str(folder / "hook-elf_runtime.py"))["datas"] == ["data of elf_runtime"]
    export = runpy.run_path(str(folder / "hook-elf_export.py"))
    assert export["datas"] == ["data of elf_export"]
    assert export["hiddenimports"] == ["modules of elf_export"]


def test_descriptors_of_both_files_match_with_each_other() -> None:
    """They are of one network, in low ranks or whole, and projected alike."""
    picture = ROOT / "demo" / "palace.jpg"
    lower, full = ElfRuntime(threads=1), ElfRuntime(bundled_model("fp32"), threads=1)
    found = lower.detect(picture)
    assert np.percentile((full.describe(picture, found.keypoints) * found.descriptors).sum(axis=1), 1) > 0.9
    assert len(match(found, full.detect(picture))) > 0.9 * len(found)
