"""Plain data, as JSON and TOML hold it, read into dataclasses by their type hints; and JSON whose numbers are sane.

`dataclasses.asdict` is the way back.
"""

from __future__ import annotations

import json
import types
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")

_WORDS = {str: "text", int: "an integer", float: "a number", bool: "true or false", dict: "an object", list: "a list"}
_NUMBERS = {int: (int,), float: (int, float)}


def read_dataclass(kind: type[T], data: Any, *, ignore_unknown: bool = False) -> T:
    """A `kind` made of a mapping, every value held against the type of its field.

    Parameters
    ----------
    kind : a dataclass
        Its fields are text, numbers, booleans, optional ones and unions of these, tuples, lists, mappings with keys of
        text, or dataclasses.  A dataclass that has a `from_dict` is read by it.
    ignore_unknown : bool
        Leave out the keys that `kind` does not know, as files of later versions have them, or refuse them.

    Raises
    ------
    ValueError
        Saying where in `data` what was expected, and what was found.
    """
    found: T = _record(kind, data, "", ignore_unknown)
    return found


def read_value(kind: Any, value: Any, *, ignore_unknown: bool = False) -> Any:
    """As `read_dataclass`, of any type hint that a field may have."""
    return _read(kind, value, "", ignore_unknown)


def read_json(text: str, largest: float) -> Any:
    """The value of a JSON text, all of whose numbers are finite and no larger than `largest`.

    Raises
    ------
    ValueError
        On another number, or what is no JSON.
    RecursionError
        On text that is nested too deep.
    """

    def real(digits: str) -> float:
        value = float(digits)
        if not abs(value) <= largest:
            raise ValueError(f"a number is {digits[:40]}, and not between -{largest:g} and {largest:g}")
        return value

    def integer(digits: str) -> int:
        real(digits)  # Python makes an integer of any number of digits, at the square of their time
        return int(digits)

    return json.loads(text, parse_int=integer, parse_float=real, parse_constant=real)


def _record(kind: Any, data: Any, where: str, ignore_unknown: bool) -> Any:
    if not isinstance(data, Mapping):
        raise _wrong(where, "an object", data)
    hints = _hints(kind)
    if not ignore_unknown and (unknown := [key for key in data if key not in hints]):
        what = f"{where} has no {unknown[0]!r}" if where else f"unknown {unknown[0]!r}"
        raise ValueError(f"{what}; known are {', '.join(hints)}")
    for field in fields(kind):
        if field.name not in data and field.default is MISSING and field.default_factory is MISSING:
            raise ValueError(f"{_below(where, field.name)} is missing")
    known = {key: value for key, value in data.items() if key in hints}
    return kind(**{k: _read(hints[k], v, _below(where, k), ignore_unknown) for k, v in known.items()})


_hints = cache(get_type_hints)


def _read(kind: Any, value: Any, where: str, ignore_unknown: bool) -> Any:
    if isinstance(kind, type) and is_dataclass(kind):
        if isinstance(value, kind):
            return value
        if hasattr(kind, "from_dict") and isinstance(value, Mapping):
            return kind.from_dict(value)
        return _record(kind, value, where, ignore_unknown)
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return _union(arguments, value, where, ignore_unknown)
    if origin in (tuple, list):
        if not isinstance(value, (tuple, list)):
            raise _wrong(where, "a list", value)
        repeated = origin is list or arguments[-1] is Ellipsis
        if not repeated and len(value) != len(arguments):
            raise _wrong(where, f"{len(arguments)} values", value)
        kinds = arguments[:1] * len(value) if repeated else arguments
        items = enumerate(zip(kinds, value, strict=True))
        return origin(_read(part, item, f"{where}[{i}]", ignore_unknown) for i, (part, item) in items)
    if origin is not None and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            raise _wrong(where, "an object", value)
        return {key: _read(arguments[1], entry, _below(where, key), ignore_unknown) for key, entry in value.items()}
    if kind is Any:
        return value
    # An integer may stand for a float; true and false are integers to Python, but no numbers here.
    if not isinstance(value, _NUMBERS.get(kind, kind)) or isinstance(value, bool) != (kind is bool):
        raise _wrong(where, _WORDS.get(kind, kind.__name__), value)
    return float(value) if kind is float else value


def _union(kinds: tuple[Any, ...], value: Any, where: str, ignore_unknown: bool) -> Any:
    """The first kind that fits; of an optional value the other kind says what is wrong with it."""
    if value is None and type(None) in kinds:
        return None
    kinds = tuple(kind for kind in kinds if kind is not type(None))
    for kind in kinds[:-1]:
        try:
            return _read(kind, value, where, ignore_unknown)
        except ValueError:
            continue
    return _read(kinds[-1], value, where, ignore_unknown)


def _below(where: str, key: object) -> str:
    return f"{where}.{key}" if where else str(key)


def _wrong(where: str, expected: str, value: object) -> ValueError:
    text = repr(value)
    found = text if len(text) <= 100 else f"{text[:100]}..."
    return ValueError(
        f"{where}: expected {expected}, found {found}" if where else f"expected {expected}, found {found}"
    )
