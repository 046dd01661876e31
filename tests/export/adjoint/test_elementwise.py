"""Rules of elementwise arithmetic, and the un-broadcasting that the engine does for them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from .oracles import Case, check, positive, rows

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 5, 7)}
PAIR = {"a": (2, 3, 4, 5), "b": (2, 3, 4, 5)}
ROW = {"a": (2, 3, 4, 5), "b": (3, 1, 5)}
BOTH = {"a": (2, 1, 4, 1), "b": (3, 1, 5)}
CHANNEL = np.array([[[0.5]], [[-2.0]], [[1.5]]])
CONDITION = np.arange(60).reshape(3, 4, 5) % 3 == 1


def pairs(name: str, op: str, function: object, **more: object) -> list[Case]:
    """An op of two inputs: same shapes, one that is broadcast, both, and a constant on either side."""
    return [
        Case(name, op, PAIR, function, dynamic_from=13, **more),
        Case(f"{name}_row", op, ROW, function, dynamic_from=13, **more),
        Case(f"{name}_both", op, BOTH, function, dynamic_from=13, **more),
        Case(f"{name}_constant", op, SHAPE, function, constants={"c": CHANNEL}, static_axes=(1,), **more),
    ]


CASES = [
    *pairs("add", "Add", lambda a, b: a + b, linear=True),
    *pairs("sub", "Sub", lambda a, b: a - b, linear=True),
    *pairs("mul", "Mul", lambda a, b: a * b, linear=True),
    *pairs("div", "Div", lambda a, b: a / b, draw=positive),
    *pairs("max", "Max", torch.maximum, opsets=(11, 12, 13, 17, 20)),
    *pairs("min", "Min", torch.minimum, opsets=(11, 12, 13, 17, 20)),
    *pairs("mean", "Mean", lambda a, b: (a + b) / 2, linear=True),
    *pairs("pow_two_inputs", "Pow", lambda a, b: a**b, draw=positive, opsets=(12, 13, 17, 20)),
    Case("sub_from_constant", "Sub", SHAPE, lambda x, c: c - x, constants={"c": 1.0}, order=["c", "x"]),
    Case(
        "div_constant",
        "Div",
        SHAPE,
        lambda x, c: c / x,
        constants={"c": 2.0},
        order=["c", "x"],
        draw=positive,
    ),
    Case("sum_1", "Sum", SHAPE, lambda x: x * 1, linear=True),
    Case(
        "sum_3",
        "Sum",
        {"a": (2, 3, 4), "b": (3, 1), "c": (4,)},
        lambda a, b, c: a + b + c,
        linear=True,
        dynamic_from=13,
    ),
    Case(
        "mean_3",
        "Mean",
        {"a": (2, 3), "b": (2, 3), "c": (3,)},
        lambda a, b, c: (a + b + c) / 3,
        dynamic_from=13,
    ),
    Case(
        "max_3",
        "Max",
        {"a": (2, 3, 4), "b": (3, 4), "c": (2, 3, 4)},
        lambda a, b, c: torch.maximum(torch.maximum(a, b), c),
        dynamic_from=13,
    ),
    Case(
        "min_3",
        "Min",
        {"a": (2, 3, 4), "b": (3, 4), "c": (2, 3, 4)},
        lambda a, b, c: torch.minimum(torch.minimum(a, b), c),
        dynamic_from=13,
    ),
    Case(
        "where",
        "Where",
        {"a": (2, 3, 4, 5), "b": (4, 1)},
        lambda a, b, c: torch.where(c, a, b),
        constants={"c": CONDITION},
        order=["c", "a", "b"],
        dynamic_from=13,
        linear=True,
        opsets=(11, 13, 16, 20),
    ),
    Case("pow_2", "Pow", SHAPE, lambda x, _e: x**2, constants={"e": 2.0}, opsets=range(11, 21)),
    Case(
        "pow_2_int",
        "Pow",
        SHAPE,
        lambda x, _e: x**2,
        constants={"e": np.int64(2)},
        opsets=(12, 13, 15, 17, 20),
    ),
    Case(
        "pow_3_int",
        "Pow",
        SHAPE,
        lambda x, _e: x**3,
        constants={"e": np.int64(3)},
        opsets=(12, 13, 15, 17, 20),
    ),
    Case("pow_half", "Pow", SHAPE, lambda x, _e: x**0.5, constants={"e": 0.5}, draw=positive),
    Case("pow_of_constant", "Pow", SHAPE, lambda x, c: c**x, constants={"c": 2.0}, order=["c", "x"]),
    Case("neg", "Neg", SHAPE, lambda x: -x, linear=True),
    Case("abs", "Abs", SHAPE, torch.abs),
    Case("reciprocal", "Reciprocal", SHAPE, lambda x: 1 / x, draw=positive),
    Case("sqrt", "Sqrt", SHAPE, torch.sqrt, draw=positive),
    Case("exp", "Exp", SHAPE, torch.exp),
    Case("log", "Log", SHAPE, torch.log, draw=positive),
    Case("sin", "Sin", SHAPE, torch.sin),
    Case("cos", "Cos", SHAPE, torch.cos),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
