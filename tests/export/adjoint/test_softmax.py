"""Rules of Softmax and LogSoftmax."""

from __future__ import annotations

import pytest
import torch

from .oracles import NEVER, Case, check, rows

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 4, 5)}


def flat(function: object, axis: int) -> object:
    """Before opset 13 all axes from `axis` on are normalised together."""
    return lambda x: function(x.flatten(axis), -1).reshape(x.shape)  # type: ignore[operator]


CASES = [
    case
    for op, function in (("Softmax", torch.softmax), ("LogSoftmax", torch.log_softmax))
    for case in (
        Case(f"{op.lower()}", op, SHAPE, lambda x, f=function: f(x, -1), opsets=(13, 17, 20)),
        Case(
            f"{op.lower()}_channels",
            op,
            SHAPE,
            lambda x, f=function: f(x, 1),
            {"axis": 1},
            opsets=(13, 17, 20),
        ),
        # The reference evaluator normalises along one axis at every opset.
        Case(f"{op.lower()}_old", op, SHAPE, flat(function, 1), opsets=(11, 12), reference_from=NEVER),
        Case(
            f"{op.lower()}_old_axis",
            op,
            SHAPE,
            flat(function, 2),
            {"axis": 2},
            opsets=(11, 12),
            reference_from=NEVER,
        ),
        Case(f"{op.lower()}_old_last", op, SHAPE, lambda x, f=function: f(x, -1), {"axis": 3}, opsets=(11, 12)),
    )
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
