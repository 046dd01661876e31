"""A suite: methods, datasets, protocol, and the tables and pictures to make of them; from TOML."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from elf_eval.errors import EvalError, reason
from elf_eval.protocol import Protocol
from elf_runtime.errors import shortened
from elf_runtime.plain import read_value

from . import variables
from .paper import PAPER, TABLES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class MethodEntry:
    """A method, and the name that it has in the tables.

    Attributes
    ----------
    name : str
    detector : str
    descriptor : str, optional
        The detector's own where absent.
    paper : str, optional
        The row of the paper's tables that stands beside it.
    optional : bool
        Where it can't be opened, leave it out, and say why in the report.
    family : str
        Methods of one family have the same marker in `elf-eval pareto`.
    """

    name: str
    detector: str
    descriptor: str | None = None
    paper: str | None = None
    optional: bool = False
    family: str = "methods"

    def __post_init__(self) -> None:
        if self.paper is not None and self.paper not in PAPER:
            raise EvalError(f"method {self.name!r}: the paper has no row {self.paper!r}; it has {list(PAPER)}")


@dataclass(frozen=True)
class DatasetEntry:
    """A dataset, and the name that it has in the tables."""

    name: str
    spec: str


@dataclass(frozen=True)
class TableEntry:
    """A table and its plot; an empty list of methods or datasets means all.

    Attributes
    ----------
    plot : "bars", "curves" (over the pairs' parameter) or "mma"
    note : str
        A paragraph above the table.
    paper : "generic" or "gradients", optional
        The paper's table whose other rows, those that ours has no method for, stand below, once for each dataset.
    """

    title: str
    datasets: list[str] = field(default_factory=list)
    methods: list[str] = field(default_factory=list)
    plot: str = "bars"
    note: str = ""
    paper: str = ""

    def __post_init__(self) -> None:
        if self.plot not in ("bars", "curves", "mma"):
            raise EvalError(f"table {self.title!r}: plot is 'bars', 'curves' or 'mma', not {self.plot!r}")
        if self.paper and self.paper not in TABLES:
            raise EvalError(f"table {self.title!r}: paper is one of {sorted(TABLES)}, not {self.paper!r}")


@dataclass(frozen=True)
class PictureEntry:
    """A picture of matches; ``pair`` is "v_graf/1.png - v_graf/3.png", and an empty list of methods means all."""

    dataset: str
    pair: str
    methods: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Suite:
    """Everything that one run does.

    Attributes
    ----------
    variables : dict
        What ``${NAME}`` means in the methods' and datasets' texts, unless there is an environment variable NAME.
    groups : dict
        Names of groups of scenes, for tables by group.
    """

    methods: list[MethodEntry]
    datasets: list[DatasetEntry]
    title: str = "Evaluation"
    note: str = ""
    protocol: Protocol = field(default_factory=Protocol)
    tables: list[TableEntry] = field(default_factory=list)
    pictures: list[PictureEntry] = field(default_factory=list)
    variables: dict[str, str] = field(default_factory=dict)
    groups: dict[str, list[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.methods or not self.datasets:
            raise EvalError("a run needs at least one method and one dataset")
        methods = _unique([m.name for m in self.methods], "method")
        datasets = _unique([d.name for d in self.datasets], "dataset")
        for table in self.tables:
            _known(table.methods, methods, f"table {table.title!r}: method")
            _known(table.datasets, datasets, f"table {table.title!r}: dataset")
        for picture in self.pictures:
            _known([picture.dataset], datasets, f"picture {picture.pair!r}: dataset")
            _known(picture.methods, methods, f"picture {picture.pair!r}: method")

    def expand(self, text: str) -> str:
        """`text` with its ``${NAME}`` replaced; EvalError where one is not set (`variables.expand`)."""
        return variables.expand(text, self.variables)

    def texts(self, entry: MethodEntry) -> tuple[str, str | None]:
        """The method's detector and descriptor, expanded."""
        return self.expand(entry.detector), self.expand(entry.descriptor) if entry.descriptor else None

    def origin(self, entry: MethodEntry | DatasetEntry) -> str:
        """What the entry's ``${NAME}`` mean, in brackets, to stand behind an error's text (`variables.origin`)."""
        texts = [entry.spec] if isinstance(entry, DatasetEntry) else [entry.detector, entry.descriptor or ""]
        return variables.origin(" ".join(texts), self.variables)

    def unexpand(self, text: str) -> str:
        """`text` with names for the variables' values, because a report should not depend on where files lie."""
        for name in self.variables:
            if value := self.expand("${" + name + "}"):
                text = text.replace(value, "${" + name + "}")
        return text

    def check_groups(self, scenes: Collection[str]) -> None:
        """Refuse a group without a scene among `scenes`, those of the datasets; some of a group may be absent."""
        for group, names in self.groups.items():
            if not set(names) & set(scenes):
                raise EvalError(f"[groups] {group}: none of {names} is in the datasets; there are {sorted(scenes)}")

    @classmethod
    def load(cls, path: Path) -> Suite:
        """From a TOML file: ``[protocol]``, ``[variables]``, ``[[method]]``, ``[[dataset]]``, ``[[table]]``,
        ``[[picture]]``, ``[groups]``, ``title`` and ``note``.

        Raises
        ------
        EvalError
            Naming the file and the entry.
        """
        try:
            with open(path, "rb") as file:
                data: dict[str, Any] = tomllib.load(file)
        except OSError as error:
            raise EvalError(f"{path}: {reason(error)}") from error
        except ValueError as error:
            raise EvalError(f"{path}: not a TOML file: {error}") from error
        known = {*_ENTRIES, *_TEXTS, *_MAPPINGS, "protocol"}
        if unknown := set(data) - known:
            raise EvalError(f"{path}: unknown {sorted(unknown)}; known are {sorted(known)}")
        try:
            data = {"method": [], "dataset": [], **data}
            return cls(**{f"{key}s" if key in _ENTRIES else key: _part(key, data[key]) for key in data})
        except EvalError as error:
            raise EvalError(f"{path}: {error}") from error


# What a suite's file holds, by its names there.
_ENTRIES = {"method": MethodEntry, "dataset": DatasetEntry, "table": TableEntry, "picture": PictureEntry}
_TEXTS = ("title", "note")
_MAPPINGS: dict[str, Any] = {"variables": dict[str, str], "groups": dict[str, list[str]]}


def _part(key: str, value: Any) -> Any:
    """What a suite has under one name of its file."""
    if key in _ENTRIES:
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            raise EvalError(f"{key}: a suite has [[{key}]] above each, not {_shown(value)}")
        return [_read(_ENTRIES[key], entry, _place(key, number, entry)) for number, entry in enumerate(value, start=1)]
    if key in _TEXTS:
        return _read(str, value, key)
    if not isinstance(value, dict):
        raise EvalError(f"{key}: a suite has [{key}] above its lines, not {_shown(value)}")
    return Protocol.from_dict(value) if key == "protocol" else _read(_MAPPINGS[key], value, f"[{key}]")


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


def _unique(names: list[str], what: str) -> set[str]:
    if doubles := {n for n in names if names.count(n) > 1}:
        raise EvalError(f"two {what}s of the same name: {sorted(doubles)}")
    return set(names)


def _known(names: list[str], known: set[str], what: str) -> None:
    if unknown := [n for n in names if n not in known]:
        raise EvalError(f"{what} {unknown} is not in the suite; there are {sorted(known)}")
