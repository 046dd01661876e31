"""Which images of a scene are matched with which."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from elf_runtime.errors import SettingError

Pair = tuple[str, str]


def exhaustive(names: Sequence[str]) -> list[Pair]:
    """Every image with every later one: up to a few hundred images."""
    return list(combinations(names, 2))


def sequential(names: Sequence[str], overlap: int) -> list[Pair]:
    """Every image with the `overlap` that follow it in the order of `names`: frames of a video, a walk."""
    if overlap < 1:
        raise SettingError(f"images of a sequence are matched with the next 1 or more, not {overlap}")
    return [(a, b) for i, a in enumerate(names) for b in names[i + 1 : i + 1 + overlap]]
