"""Rules of reductions and global pooling."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from .oracles import NEVER, Case, apart, check, rows
from .runs import run_ort, with_adjoint

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 4, 5)}


def reductions(op: str, function: Any, moved: int, **more: Any) -> list[Case]:
    """Rows for one op; its axes are an attribute before opset `moved`, an input from there on."""
    before = [o for o in (11, 13, 17) if o < moved]
    after = [o for o in (13, 18, 20) if o >= moved]
    found = []
    for label, axes, keep in (
        ("hw", [2, 3], 1),
        ("hw_dropped", [-1, 2], 0),
        ("c", [1], 1),
        ("nc_dropped", [0, 1], 0),
    ):

        def torch_of(x: torch.Tensor, *_: torch.Tensor, axes: list[int] = axes, keep: int = keep) -> torch.Tensor:
            return function(x, tuple(axes), bool(keep))

        name = f"{op}_{label}".lower()
        found.append(Case(f"{name}_attr", op, SHAPE, torch_of, {"axes": axes, "keepdims": keep}, opsets=before, **more))
        found.append(
            Case(name, op, SHAPE, torch_of, {"keepdims": keep}, {"axes": np.array(axes)}, opsets=after, **more)
        )
    whole = Case(
        f"{op}_all".lower(), op, SHAPE, lambda x: function(x, (0, 1, 2, 3), False), {"keepdims": 0},
        opsets=(11, 13, 18, 20), **more,
    )  # fmt: skip
    nothing = Case(
        f"{op}_nothing".lower(), op, SHAPE, lambda x: function(x, (), True) if op != "ReduceSum" else x * 1,
        {"noop_with_empty_axes": 1}, opsets=(13, 20) if moved == 13 else (), **more,
    )  # fmt: skip
    return [*found, whole, nothing]


def running_sum(x: torch.Tensor, axis: int, exclusive: int, reverse: int) -> torch.Tensor:
    """CumSum, by torch's, which has neither of the two switches."""
    ordered = x.flip(axis) if reverse else x
    summed = ordered.cumsum(axis) - (ordered if exclusive else 0)
    return summed.flip(axis) if reverse else summed


CASES = [
    *(
        Case(
            f"cumsum_{axis}_{exclusive}{reverse}",
            "CumSum",
            SHAPE,
            lambda x, _a, axis=axis, exclusive=exclusive, reverse=reverse: running_sum(x, axis, exclusive, reverse),
            {"exclusive": exclusive, "reverse": reverse},
            {"a": np.array(axis)},
            opsets=(11, 14, 20),
            linear=True,
        )
        for axis, exclusive, reverse in ((1, 0, 0), (3, 1, 0), (-2, 0, 1), (2, 1, 1))
    ),
    *reductions("ReduceSum", lambda x, a, k: x.sum(a, keepdim=k), 13, linear=True),
    *reductions("ReduceMean", lambda x, a, k: x.mean(a, keepdim=k), 18, linear=True),
    *reductions("ReduceMax", lambda x, a, k: x.amax(a, keepdim=k), 18),
    *reductions("ReduceMin", lambda x, a, k: x.amin(a, keepdim=k), 18),
    *reductions("ReduceL1", lambda x, a, k: x.abs().sum(a, keepdim=k), 18),
    *reductions("ReduceL2", lambda x, a, k: (x * x).sum(a, keepdim=k).sqrt(), 18),
    *reductions("ReduceSumSquare", lambda x, a, k: (x * x).sum(a, keepdim=k), 18),
    *reductions("ReduceLogSumExp", lambda x, a, k: torch.logsumexp(x, a, keepdim=k), 18),
    Case("global_average", "GlobalAveragePool", SHAPE, lambda x: x.mean((2, 3), keepdim=True), linear=True),
    Case(
        "global_average_volume",
        "GlobalAveragePool",
        {"x": (2, 3, 2, 3, 4)},
        lambda x: x.mean((2, 3, 4), keepdim=True),
        linear=True,
    ),
    Case("global_max", "GlobalMaxPool", SHAPE, lambda x: x.amax((2, 3), keepdim=True)),
    Case(
        "global_max_line",
        "GlobalMaxPool",
        {"x": (2, 3, 6)},
        lambda x: x.amax(2, keepdim=True),
        reference_from=NEVER,  # the reference evaluator wants two spatial axes
        draw=apart,
    ),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)


def both(op: str, **attrs: Any) -> Any:
    case = Case("ties", op, {"x": (1, 1, 2, 3)}, torch.abs, attrs)
    return with_adjoint(case.model(17, dynamic=True, dtype=np.float32), "x")


def test_ties_of_a_global_max_go_to_the_first() -> None:
    x = np.array([[[[1, 4, 0], [4, 4, 2]]]], np.float32)
    _, dx = run_ort(both("GlobalMaxPool"), {"x": x, "seed": np.full((1, 1, 1, 1), 6, np.float32)})
    assert dx.tolist() == [[[[0, 6, 0], [0, 0, 0]]]]


def test_ties_of_a_reduction_share() -> None:
    x = np.array([[[[1, 4, 0], [4, 4, 2]]]], np.float32)
    _, dx = run_ort(both("ReduceMax", axes=[2, 3]), {"x": x, "seed": np.full((1, 1, 1, 1), 6, np.float32)})
    assert dx.tolist() == [[[[0, 2, 0], [2, 2, 0]]]]


def test_the_norm_of_zeros_gives_a_finite_gradient() -> None:
    x = np.zeros((1, 1, 2, 3), np.float32)
    _, dx = run_ort(both("ReduceL2", axes=[1]), {"x": x, "seed": np.ones((1, 1, 2, 3), np.float32)})
    assert dx.tolist() == x.tolist()
