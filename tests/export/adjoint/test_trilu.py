"""Rule of Trilu."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from .oracles import Case, check, rows

pytestmark = pytest.mark.torch

X = {"x": (2, 3, 4, 5)}

CASES = [
    Case("upper", "Trilu", X, torch.triu, opsets=(14, 17, 20), linear=True),
    Case("lower", "Trilu", X, torch.tril, {"upper": 0}, opsets=(14, 17, 20), linear=True),
    Case("above_diagonal_2", "Trilu", X, lambda x, _: torch.triu(x, 2), {}, {"k": np.array(2)},
         opsets=(14, 17, 20), linear=True),
    Case("below_diagonal_minus_1", "Trilu", X, lambda x, _: torch.tril(x, -1), {"upper": 0}, {"k": np.array(-1)},
         opsets=(14, 17, 20), linear=True),
]  # fmt: skip


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
