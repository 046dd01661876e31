"""A sweep's grid: the values that each setting is tried with, and the methods' texts that they make."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from itertools import product

import numpy as np

from elf_eval.errors import EvalError
from elf_eval.spec import Spec
from elf_runtime.errors import suggestion
from elf_runtime.params import SETTINGS, setting_value

_MOST = 1000  # values of a range
_WITH_SETTINGS = ("elf", "sobel", "laplacian", "plugin")  # methods that may take detection settings


def parse_grid(items: list[str]) -> dict[str, list[str]]:
    """``["scale=1/0.5", "denoise=3..9..2,4..6"]`` -> the values of each setting.

    A value, or each part of one between commas, may be a range, ``FROM..TO`` or ``FROM..TO..STEP``, which includes
    both ends.  Of several ranges in a value every combination is taken.

    Raises
    ------
    EvalError
        On an unknown setting, or a value that it can't take.
    """
    grid: dict[str, list[str]] = {}
    for item in items:
        name, _, values = item.partition("=")
        if name not in SETTINGS:
            raise EvalError(
                f"grid {item!r}: unknown setting {name!r}; known are {sorted(SETTINGS)}{suggestion(name, SETTINGS)}"
            )
        try:
            grid[name] = list(dict.fromkeys(v for text in values.split("/") for v in _in_range(text)))
            for text in grid[name]:
                setting_value(name, text)
        except (ValueError, ArithmeticError) as error:
            raise EvalError(f"grid {item!r}: {error}") from error
    return grid


def _in_range(text: str) -> list[str]:
    """The values that a text with ranges stands for.  Decimals are exact, so that 0.1..0.3..0.1 ends with 0.3."""
    parts = []
    for part in text.split(","):
        ends = part.split("..")
        if len(ends) == 1:
            parts.append([part])
            continue
        if len(ends) > 3 or not all(map(_is_decimal, ends)):
            raise ValueError(f"{part!r} is not FROM..TO or FROM..TO..STEP")
        first, last, step = (Decimal(end) for end in [*ends, "1"][:3])
        if step <= 0 or last < first:
            raise ValueError(f"{part!r}: a range goes upwards, by a step above 0")
        count = int((last - first) / step) + 1
        if count > _MOST:
            raise ValueError(f"{part!r} has {count} values; at most {_MOST}")
        parts.append([f"{first + k * step:f}" for k in range(count)])
    return [",".join(values) for values in product(*parts)]


def _is_decimal(text: str) -> bool:
    return re.fullmatch(r"-?[0-9]+(\.[0-9]+)?", text) is not None


def grid_methods(models: Sequence[str], grid: Mapping[str, Sequence[str]], limit: int | None, seed: int) -> list[str]:
    """The text of every model with every combination of settings.

    The first one is always the first model as it is.  Where there are more than `limit`, so many are drawn by `seed`.

    Raises
    ------
    EvalError
        If there is a grid, and a model is a method of another kind, which has no such settings.
    """
    kinds = {model: Spec.parse(model).kind for model in models}
    if grid and (others := [model for model, kind in kinds.items() if kind not in _WITH_SETTINGS]):
        raise EvalError(
            f"{others[0]}: --grid is of ELF's settings, which elf:, sobel and laplacian take; another method's own "
            f"options are models: --model '{kinds[others[0]]}?OPTION=VALUE', or say it by --beside"
        )
    texts = [models[0]]
    for model in models:
        for values in product(*grid.values()):
            options = "&".join(f"{name}={value}" for name, value in zip(grid, values, strict=True))
            texts.append(model + ("&" if "?" in model else "?") + options if options else model)
    unique = list(dict.fromkeys(texts))
    if limit is None or limit >= len(unique):
        return unique
    drawn = np.random.default_rng(seed).choice(len(unique) - 1, limit - 1, replace=False) + 1
    return [unique[0], *(unique[i] for i in sorted(drawn))]
