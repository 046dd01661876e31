"""Which images of a scene are matched with which."""

from __future__ import annotations

import re
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


def pairs_of(names: Sequence[str], rule: str) -> list[Pair]:
    """By ``exhaustive`` or ``sequential:N``.

    Raises
    ------
    SettingError
        On another rule.
    """
    if rule == "exhaustive":
        return exhaustive(names)
    found = re.fullmatch("sequential:0*([1-9][0-9]{0,8})", rule)
    if found is None:
        raise SettingError(f"pairs are 'exhaustive' or 'sequential:N' with N from 1 on, not {rule!r}")
    return sequential(names, int(found[1]))
