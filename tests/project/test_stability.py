"""What docs/stability.md calls public can be imported, and the version and the schema are stated once."""

from __future__ import annotations

import inspect
import re
from importlib import import_module

import pytest

from elf_runtime.contract import SCHEMA_VERSION
from helpers import ROOT

PAGE = (ROOT / "docs" / "stability.md").read_text(encoding="utf-8")
FUNCTIONS = re.findall(r"^- `(elf_\w+)\.([\w.]+)\.(\w+)`$", PAGE, re.MULTILINE)
EXPORTS = pytest.param("elf_export", marks=pytest.mark.torch)


def test_what_reconstruction_exports_is_there_without_pycolmap() -> None:
    assert "What `elf_runtime.reconstruction` exports (its `__all__`) is public" in PAGE
    room = import_module("elf_runtime.reconstruction")
    assert all(callable(getattr(room, name)) for name in room.__all__)


@pytest.mark.parametrize("package", ["elf_runtime", EXPORTS])
def test_what_is_called_public_is_there(package: str) -> None:
    functions = [(module, name) for home, module, name in FUNCTIONS if home == package]
    assert len(functions) == {"elf_runtime": 11, "elf_export": 0}[package]
    for module, name in functions:
        assert callable(getattr(import_module(f"{package}.{module}"), name))
    exported = import_module(package).__all__
    assert exported
    for name in exported:
        assert getattr(import_module(package), name) is not None


def test_what_users_call_has_a_docstring() -> None:
    """Of the classes that `elf_runtime` exports, which docs/api.md shows."""
    package = import_module("elf_runtime")
    for owner in filter(inspect.isclass, (getattr(package, name) for name in package.__all__)):
        for name, member in inspect.getmembers(owner):
            if not name.startswith("_") and (callable(member) or isinstance(member, property)):
                assert inspect.getdoc(member), f"{owner.__name__}.{name}"


def test_the_schema_is_the_one_stated() -> None:
    assert f"a whole number in each model's metadata, {SCHEMA_VERSION} today." in PAGE


def test_the_version_is_stated_in_one_place() -> None:
    """elf_runtime/version.py has it: what else could state one reads it from there, or leaves it out."""
    for file in ("pyproject.toml", "CITATION.cff"):
        text = (ROOT / file).read_text(encoding="utf-8")
        assert re.findall(r"^version\b", text, re.MULTILINE) == [], file
    sources = [path for folder in ("export", "runtime", "evaluation") for path in (ROOT / folder).rglob("*.py")]
    stating = [path.parent.name for path in sources if re.search(r"^__version__\s*=", path.read_text("utf-8"), re.M)]
    assert stating == ["elf_runtime"]
