"""Plain data into dataclasses: what fits is taken, and what does not is said with its place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import pytest

from elf_runtime.plain import read_dataclass, read_json, read_value


@dataclass(frozen=True)
class Part:
    name: str
    weight: float = 1.0


@dataclass(frozen=True)
class Whole:
    parts: tuple[Part, ...]
    size: tuple[int, int] | None = None
    limit: str | int = "none"
    flags: list[bool] = field(default_factory=list)
    counts: Mapping[str, int] = field(default_factory=dict)
    extra: Any = None


WHOLE = Whole((Part("a"), Part("b", 2)), (3, 4), 5, [True, False], {"x": 1}, {"any": [1, "thing"]})


def test_what_is_written_is_read_back() -> None:
    assert read_dataclass(Whole, asdict(WHOLE)) == WHOLE
    assert read_dataclass(Whole, {"parts": []}) == Whole(())
    lists = {**asdict(WHOLE), "size": [3, 4], "parts": [{"name": "a"}]}  # as JSON has tuples
    assert read_dataclass(Whole, lists).size == (3, 4)
    assert read_dataclass(Whole, {"parts": [], "size": None}).size is None


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ([], "^expected an object, found \\[\\]$"),
        ({}, "^parts is missing$"),
        ({"parts": {}}, "^parts: expected a list, found {}$"),
        ({"parts": [{"name": 7}]}, r"^parts\[0\]\.name: expected text, found 7$"),
        ({"parts": [{"name": "a"}, {"weight": 1}]}, r"^parts\[1\]\.name is missing$"),
        ({"parts": [{"name": "a", "weight": True}]}, r"^parts\[0\]\.weight: expected a number, found True$"),
        ({"parts": [{"name": "a", "color": 1}]}, r"^parts\[0\] has no 'color'; known are name, weight$"),
        ({"parts": [], "size": [1]}, r"^size: expected 2 values, found \[1\]$"),
        ({"parts": [], "size": [1, 2.5]}, r"^size\[1\]: expected an integer, found 2.5$"),
        ({"parts": [], "limit": 1.5}, "^limit: expected an integer, found 1.5$"),
        ({"parts": [], "flags": [1]}, r"^flags\[0\]: expected true or false, found 1$"),
        ({"parts": [], "counts": {"x": "y" * 500}}, r"^counts\.x: expected an integer, found 'y{99}\.\.\.$"),
        ({"parts": [], "speed": 1}, "^unknown 'speed'; known are parts, "),
    ],
)
def test_what_does_not_fit_is_said_with_its_place(data: object, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_dataclass(Whole, data)


def test_keys_of_later_versions_can_be_left_out() -> None:
    later = {"parts": [{"name": "a", "color": 1}], "speed": 1}
    assert read_dataclass(Whole, later, ignore_unknown=True) == Whole((Part("a"),))


def test_a_value_alone_has_no_place() -> None:
    assert read_value(float, 3) == 3
    assert isinstance(read_value(float, 3), float)
    assert isinstance(read_value(int | float, 3), int)
    with pytest.raises(ValueError, match=r"^expected text, found 3$"):
        read_value(str, 3)


@pytest.mark.parametrize("text", ["NaN", "[Infinity]", "1e16", "-1e300", "9" * 10_000, "{"])
def test_numbers_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"a number is|Expecting"):
        read_json(text, 1e15)
    assert read_json('{"a": [1, 2.5, -3]}', 1e15) == {"a": [1, 2.5, -3]}
