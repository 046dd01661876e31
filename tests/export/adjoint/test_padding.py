"""Rule of Pad."""

from __future__ import annotations

import numpy as np
import pytest
import torch.nn.functional as F

from .oracles import Case, check, rows

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 4, 5)}
BORDERS = np.array([0, 0, 1, 2, 0, 0, 3, 1])  # 1 row above, 2 columns before, 3 rows below, 1 column behind


def by_mode(mode: str) -> object:
    return lambda x, *_: F.pad(x, [2, 1, 1, 3], mode=mode)


CASES = [
    Case(
        "constant",
        "Pad",
        SHAPE,
        by_mode("constant"),
        constants={"p": BORDERS},
        opsets=(11, 13, 17, 18, 19, 20),
        linear=True,
    ),
    Case(
        "constant_value",
        "Pad",
        SHAPE,
        lambda x, _p, _v: F.pad(x, [2, 1, 1, 3], value=1.5),
        {"mode": "constant"},
        {"p": BORDERS, "v": 1.5},
        linear=True,
    ),
    Case(
        "computed",
        "Pad",
        SHAPE,
        by_mode("constant"),
        constants={"p": BORDERS},
        computed=("p",),
        opsets=(11, 17),
        linear=True,
    ),
    Case(
        "channels",
        "Pad",
        SHAPE,
        lambda x, _p: F.pad(x, [0, 0, 0, 0, 1, 2, 0, 1]),
        constants={"p": np.array([0, 1, 0, 0, 1, 2, 0, 0])},
        linear=True,
    ),
    Case(
        "reflect",
        "Pad",
        SHAPE,
        by_mode("reflect"),
        {"mode": "reflect"},
        {"p": BORDERS},
        opsets=(11, 13, 17, 18, 20),
        linear=True,
    ),
    Case(
        "edge",
        "Pad",
        SHAPE,
        by_mode("replicate"),
        {"mode": "edge"},
        {"p": BORDERS},
        opsets=(11, 13, 17, 18, 20),
        linear=True,
    ),
    Case(
        "wrap",
        "Pad",
        SHAPE,
        by_mode("circular"),
        {"mode": "wrap"},
        {"p": BORDERS},
        opsets=(19, 20),
        linear=True,
    ),
    Case(
        "axes",
        "Pad",
        SHAPE,
        by_mode("reflect"),
        {"mode": "reflect"},
        {"p": np.array([2, 1, 1, 3]), "axes": np.array([-1, 2])},
        order=["x", "p", "", "axes"],
        opsets=(18, 20),
        linear=True,
    ),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
