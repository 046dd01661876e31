"""Rule of Trilu."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from .oracles import Case, check, rows

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 4, 5)}
OPSETS = (14, 17, 20)

CASES = [
    Case("upper", "Trilu", SHAPE, torch.triu, opsets=OPSETS, linear=True),
    Case("lower", "Trilu", SHAPE, torch.tril, {"upper": 0}, opsets=OPSETS, linear=True),
    Case("above_diagonal_2", "Trilu", SHAPE, lambda x, _: torch.triu(x, 2), constants={"k": np.array(2)}, opsets=OPSETS,
         linear=True),
    Case("below_diagonal_minus_1", "Trilu", SHAPE, lambda x, _: torch.tril(x, -1), {"upper": 0},
         {"k": np.array(-1)}, opsets=OPSETS, linear=True),
]  # fmt: skip


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
