"""Rules of normalisation layers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from .oracles import Case, check, rows
from .stand_ins import local_response

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 4, 3, 5)}
SCALE, BIAS = np.array([0.5, -1.0, 2.0, 1.5]), np.array([0.1, 0.2, -0.3, 0.0])
MEAN, VARIANCE = np.array([0.5, -0.5, 0.0, 1.0]), np.array([0.25, 1.0, 4.0, 2.0])
EPS = 1e-5
NORM = {"tolerance32": 3e-5, "tolerance64": 1e-6}  # epsilon is a float32 attribute: 1e-5 to 1e-8 of itself


def layer_norm(x: torch.Tensor, scale: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
    return F.layer_norm(x, scale.shape, scale, bias, EPS)


def response(size: int, alpha: float = 0.5, beta: float = 0.75, bias: float = 1.0) -> object:
    return lambda x: local_response(x, size, alpha, beta, bias)


CASES = [
    Case(
        "batch",
        "BatchNormalization",
        SHAPE,
        lambda x, s, b, m, v: F.batch_norm(x, m, v, s, b, eps=EPS),
        constants={"s": SCALE, "b": BIAS, "m": MEAN, "v": VARIANCE},
        opsets=range(11, 21),
        linear=True,
        reference_from=14,
        **NORM,
    ),
    Case(
        "batch_line",
        "BatchNormalization",
        {"x": (2, 4, 7)},
        lambda x, s, b, m, v: F.batch_norm(x, m, v, s, b, eps=1e-3),
        {"epsilon": 1e-3},
        {"s": SCALE, "b": BIAS, "m": MEAN, "v": VARIANCE},
        opsets=(11, 17),
        linear=True,
        reference_from=14,
        **NORM,
    ),
    Case(
        "batch_rank_2",
        "BatchNormalization",
        {"x": (2, 4)},
        lambda x, s, b, m, v: F.batch_norm(x, m, v, s, b, eps=EPS),
        constants={"s": SCALE, "b": BIAS, "m": MEAN, "v": VARIANCE},
        opsets=(11, 17),
        linear=True,
        reference_from=14,
        **NORM,
    ),
    Case(
        "batch_computed",
        "BatchNormalization",
        SHAPE,
        lambda x, s, b, m, v: F.batch_norm(x, m, v, s, b, eps=EPS),
        constants={"s": SCALE, "b": BIAS, "m": MEAN, "v": VARIANCE},
        computed=("s", "b", "m", "v"),
        opsets=(14, 17),
        linear=True,
        **NORM,
    ),
    Case(
        "instance",
        "InstanceNormalization",
        SHAPE,
        lambda x, s, b: F.instance_norm(x, weight=s, bias=b, eps=EPS),
        constants={"s": SCALE, "b": BIAS},
        **NORM,
    ),
    Case(
        "instance_line",
        "InstanceNormalization",
        {"x": (2, 4, 9)},
        lambda x, s, b: F.instance_norm(x, weight=s, bias=b, eps=EPS),
        constants={"s": SCALE, "b": BIAS},
        **NORM,
    ),
    Case(
        "layer",
        "LayerNormalization",
        {"x": (2, 3, 4)},
        layer_norm,
        constants={"s": SCALE, "b": BIAS},
        opsets=(17, 18, 20),
        **NORM,
    ),
    Case(
        "layer_axis",
        "LayerNormalization",
        {"x": (2, 3, 2, 4)},
        layer_norm,
        {"axis": 2},
        {"s": np.outer([1.0, -0.5], SCALE), "b": np.outer([1.0, 2.0], BIAS)},
        opsets=(17, 18, 20),
        **NORM,
    ),
    Case(
        "layer_no_bias",
        "LayerNormalization",
        {"x": (2, 3, 4)},
        lambda x, s: F.layer_norm(x, (4,), s, None, EPS),
        constants={"s": SCALE},
        opsets=(17, 20),
        **NORM,
    ),
    Case(
        "group",
        "GroupNormalization",
        SHAPE,
        lambda x, s, b: F.group_norm(x, 2, s, b, EPS),
        {"num_groups": 2},
        {"s": SCALE, "b": BIAS},
        opsets=(21, 22),
        static_axes=(1,),
        **NORM,
    ),
    Case("lp_2", "LpNormalization", SHAPE, lambda x: x / x.norm(dim=1, keepdim=True), {"axis": 1}),
    Case("lp_2_last", "LpNormalization", SHAPE, lambda x: x / x.norm(dim=-1, keepdim=True), opsets=(11, 17, 22)),
    Case(
        "lp_1",
        "LpNormalization",
        SHAPE,
        lambda x: x / x.norm(p=1, dim=1, keepdim=True),
        {"axis": 1, "p": 1},
    ),
    Case("lrn_3", "LRN", SHAPE, response(3), {"size": 3, "alpha": 0.5}),
    Case(
        "lrn_5",
        "LRN",
        {"x": (2, 9, 3, 4)},
        response(5, 0.25, 0.5, 2.0),
        {"size": 5, "alpha": 0.25, "beta": 0.5, "bias": 2.0},
    ),
    Case("lrn_1", "LRN", SHAPE, response(1), {"size": 1, "alpha": 0.5}),
    Case("lrn_wider", "LRN", SHAPE, response(15), {"size": 15, "alpha": 0.5}),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
