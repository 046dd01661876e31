"""A suite's file: TOML, and the files that it includes."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from elf_eval.errors import EvalError, reason
from elf_eval.protocol import Protocol
from elf_runtime.errors import shortened
from elf_runtime.plain import read_value

from .suite import DatasetEntry, MethodEntry, PictureEntry, Suite, TableEntry

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# What a suite's file holds, by its names there.
_ENTRIES = {"method": MethodEntry, "dataset": DatasetEntry, "table": TableEntry, "picture": PictureEntry}
_TEXTS = ("title", "note")
_MAPPINGS: dict[str, Any] = {"variables": dict[str, str], "groups": dict[str, list[str]]}
_INCLUDE = "include"


def load_suite(path: Path) -> Suite:
    """From a TOML file: ``[protocol]``, ``[variables]``, ``[[method]]``, ``[[dataset]]``, ``[[table]]``,
    ``[[picture]]``, ``[groups]``, ``title``, ``note`` and ``include``.

    ``include = ["parts/generic.toml"]`` names files beside this one, whose contents come first.  A method, dataset or
    table of the same name takes the place of an included one; so do single settings, variables and the title.  The
    included notes stand below the file's own.

    Raises
    ------
    EvalError
        Naming the file and the entry.
    """
    parts = _parts(path, ())
    try:
        protocol = Protocol.from_dict(parts.pop("protocol", {}))
        named = {f"{key}s" if key in _ENTRIES else key: value for key, value in parts.items()}
        return Suite(**{"methods": [], "datasets": [], **named, "protocol": protocol})
    except EvalError as error:
        raise EvalError(f"{path}: {error}") from error


def _parts(path: Path, within: tuple[Path, ...]) -> dict[str, Any]:
    """What a file and those that it includes hold, by the names in a file; the protocol as plain data."""
    if path.resolve() in within:
        raise EvalError(f"{path}: it includes itself")
    data = _toml(path)
    try:
        included = _part(_INCLUDE, data.pop(_INCLUDE, []))
        own = {key: _part(key, value) for key, value in data.items()}
    except EvalError as error:
        raise EvalError(f"{path}: {error}") from error
    merged: dict[str, Any] = {}
    for name in included:
        merged = _over(merged, _parts(path.parent / name, (*within, path.resolve())))
    return _over(merged, own)


def _over(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Two files' parts together, where the second goes before the first."""
    merged = dict(first)
    for key, value in second.items():
        if key not in merged:
            merged[key] = value
        elif key in _ENTRIES:
            changed = {_name(entry): entry for entry in value}
            kept = [changed.pop(_name(entry), entry) for entry in merged[key]]
            merged[key] = [*kept, *(entry for entry in value if _name(entry) in changed)]
        elif key == "note":
            merged[key] = f"{value}\n\n{merged[key]}"
        elif key == "title":
            merged[key] = value
        else:
            merged[key] = {**merged[key], **value}
    return merged


def _name(entry: MethodEntry | DatasetEntry | TableEntry | PictureEntry) -> object:
    """By what an entry is replaced; of pictures nothing is."""
    return entry.name if isinstance(entry, (MethodEntry, DatasetEntry)) else getattr(entry, "title", id(entry))


def _toml(path: Path) -> dict[str, Any]:
    try:
        with open(path, "rb") as file:
            data: dict[str, Any] = tomllib.load(file)
    except OSError as error:
        raise EvalError(f"{path}: {reason(error)}") from error
    except ValueError as error:
        raise EvalError(f"{path}: not a TOML file: {error}") from error
    known = {*_ENTRIES, *_TEXTS, *_MAPPINGS, "protocol", _INCLUDE}
    if unknown := set(data) - known:
        raise EvalError(f"{path}: unknown {sorted(unknown)}; known are {sorted(known)}")
    return data


def _part(key: str, value: Any) -> Any:
    """What a suite has under one name of its file."""
    if key in _ENTRIES:
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            raise EvalError(f"{key}: a suite has [[{key}]] above each, not {_shown(value)}")
        return [_read(_ENTRIES[key], entry, _place(key, number, entry)) for number, entry in enumerate(value, start=1)]
    if key in _TEXTS:
        return _read(str, value, key)
    if key == _INCLUDE:
        return _read(list[str], value, key)
    if not isinstance(value, dict):
        raise EvalError(f"{key}: a suite has [{key}] above its lines, not {_shown(value)}")
    if key == "protocol":
        Protocol.from_dict(value)  # refused here, where the file is known
        return value
    return _read(_MAPPINGS[key], value, f"[{key}]")


def _place(key: str, number: int, entry: Mapping[str, Any]) -> str:
    """Which entry it is: by its number, and its name or title where it has one."""
    name = entry.get("name", entry.get("title"))
    return f"[[{key}]] {number}" + (f" ({name!r})" if isinstance(name, str) else "")


def _read(kind: Any, value: Any, place: str) -> Any:
    try:
        return read_value(kind, value)
    except ValueError as error:
        raise EvalError(f"{place}: {error}") from error


def _shown(value: object) -> str:
    return shortened(repr(value), 100)
