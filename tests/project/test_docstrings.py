"""The API page leaves out what has no docstring, so each name there has one, and each public method of its classes."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from typing import Any

import pytest

from helpers import ROOT

NAMES = re.findall(r"^::: (\S+)$", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"), re.MULTILINE)
PACKAGES = ("elf_runtime", "elf_export")


def without(cls: type) -> list[str]:
    """Public methods and properties of our own classes, inherited ones too, that have no docstring of their own."""
    found = []
    for base in cls.__mro__:
        for name, member in vars(base).items() if base.__module__.startswith(PACKAGES) else ():
            function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
            if not name.startswith("_") and inspect.isfunction(function) and not (function.__doc__ or "").strip():
                found.append(f"{base.__name__}.{name}")
    return found


def of(name: str) -> Any:
    module, _, last = name.rpartition(".")
    return getattr(import_module(module), last)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.torch if n.startswith("elf_export") else ()) for n in NAMES]
)
def test_a_name_of_the_api_page_has_docstrings(name: str) -> None:
    found = of(name)
    if inspect.isclass(found):
        assert without(found) == []
    assert not callable(found) or (inspect.getdoc(found) or "").strip()


def test_what_has_none_is_found() -> None:
    class Base:
        def said(self) -> None:
            """Said."""

        def unsaid(self) -> None: ...

        def _own(self) -> None: ...

    class Derived(Base):
        @property
        def value(self) -> int:
            return 1

        @classmethod
        def made(cls) -> None: ...

    Base.__module__ = Derived.__module__ = "elf_runtime.made_up"
    assert without(Derived) == ["Derived.value", "Derived.made", "Base.unsaid"]
