"""Digests of files and of code: what features and metrics depend on, beside their settings."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import elf_runtime

_PACKAGES = {"elf_runtime": Path(elf_runtime.__file__).parent, "elf_eval": Path(__file__).parent}


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes."""
    sha = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            sha.update(block)
    return sha.hexdigest()


def code_digest(*modules: str) -> str:
    """Digest of what modules compute, so that edited code is not measured by yesterday's features.

    Comments, docstrings and imports don't count, nor does where a module lies: none of them changes a figure.

    Parameters
    ----------
    modules : str
        Names in `elf_runtime` or `elf_eval`.  A package is all that lies in it.
    """
    digests = {_statements(path) for module in modules for path in _files(module)}
    return hashlib.sha256("".join(sorted(digests)).encode()).hexdigest()[:12]


def _files(module: str) -> Iterator[Path]:
    package, *parts = module.split(".")
    path = _PACKAGES[package].joinpath(*parts)
    yield from path.rglob("*.py") if path.is_dir() else [path.with_suffix(".py")]


@cache
def _statements(path: Path) -> str:
    tree = ast.parse(path.read_bytes())
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [child for child in body if not _is_silent(child)]  # type: ignore[attr-defined]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def _is_silent(node: ast.AST) -> bool:
    """Whether a statement is an import, or a string on its own, which is a docstring."""
    if isinstance(node, (ast.Import, ast.ImportFrom)):
        return True
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
