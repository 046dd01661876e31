"""The rows of all files here: each `test_*.py` that assigns ``CASES`` has its rows among them, and needs no entry."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from .oracles import Case

FILES = [
    path for path in sorted(Path(__file__).parent.glob("test_*.py")) if "\nCASES = " in path.read_text(encoding="utf-8")
]
CASES: list[Case] = [
    case for path in FILES for case in import_module(f".{path.stem}", __package__).CASES if case.opsets
]


def named(name: str) -> Case:
    """The one row of that name."""
    (case,) = (case for case in CASES if case.name == name)
    return case
