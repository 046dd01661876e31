"""Checks of single values: each gives a setting's value as Python's own type, or None where a setting can't have it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

Blur = tuple[int, float]
WIDEST_BLUR = 999  # pixels; wider ones leave nothing of an image
MOST_SCALES = 5  # each takes a session, and a pass of the network


def is_int(value: object) -> bool:
    """Whether it is an integer, of Python or of numpy, and not a bool."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def is_number(value: object) -> bool:
    """Whether it is an integer as `is_int` says, or a float, of Python or of numpy."""
    return is_int(value) or isinstance(value, (float, np.floating))


Checked = Callable[[Any], Any]
"""Gives a value as Python's own type, or None where a setting can't have it."""


def integer(value: Any) -> int | None:
    return int(value) if is_int(value) and value >= 0 else None


def positive(value: Any) -> int | None:
    return int(value) if is_int(value) and value >= 1 else None


def number(most: float, above: float = -1.0) -> Checked:
    """Numbers from 0 to `most`, above `above`."""
    return lambda value: float(value) if is_number(value) and 0.0 <= value <= most and value > above else None


def word(words: Sequence[str], other: Checked) -> Checked:
    """One of the words, or what `other` takes."""
    return lambda value: (str(value) if value in words else None) if isinstance(value, str) else other(value)


def boolean(value: Any) -> bool | None:
    return value if isinstance(value, bool) else None


def _is_pair(value: Any) -> bool:
    return isinstance(value, (tuple, list)) and len(value) == 2


def blur(value: Any) -> Blur | None:
    if not (_is_pair(value) and is_int(value[0]) and is_number(value[1])):
        return None
    mu, sigma = int(value[0]), float(value[1])
    return (mu, sigma) if 1 <= mu <= WIDEST_BLUR and mu % 2 == 1 and 0.0 < sigma < float("inf") else None


def grid(value: Any) -> tuple[int, int] | None:
    if not (_is_pair(value) and all(is_int(count) and count >= 1 for count in value)):
        return None
    return int(value[0]), int(value[1])


_SCALE = number(8.0, above=0.0)


def scales(value: Any) -> tuple[float, ...] | None:
    """Working scales in ascending order, none twice; 'none' is none of them, and a number one."""
    if isinstance(value, str):
        return () if value == "none" else None
    parts = list(value) if isinstance(value, (tuple, list)) else [value]
    found = {scale for scale in map(_SCALE, parts) if scale is not None}
    return tuple(sorted(found)) if len(found) == len(parts) <= MOST_SCALES else None
