"""Rules of the activations made of straight pieces."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F

from .oracles import Case, check, rows, wide

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 5, 7)}


CASES = [
    Case("relu", "Relu", SHAPE, F.relu, opsets=range(11, 21)),
    Case("leaky_relu", "LeakyRelu", SHAPE, F.leaky_relu, opsets=(11, 16, 20)),
    Case("leaky_relu_alpha", "LeakyRelu", SHAPE, lambda x: F.leaky_relu(x, -0.25), {"alpha": -0.25}),
    Case(
        "p_relu",
        "PRelu",
        SHAPE,
        lambda x, a: torch.where(x > 0, x, a * x),
        constants={"a": [[[0.25]], [[-0.5]], [[2.0]]]},
        opsets=(11, 16, 20),
    ),
    Case(
        "p_relu_slope",
        "PRelu",
        {"x": (2, 3, 5, 7), "a": (3, 1, 1)},
        lambda x, a: torch.where(x > 0, x, a * x),
        dynamic_from=13,
    ),
    Case("thresholded_relu", "ThresholdedRelu", SHAPE, lambda x: F.threshold(x, 0.5, 0), {"alpha": 0.5}),
    Case("thresholded_relu_default", "ThresholdedRelu", SHAPE, lambda x: F.threshold(x, 1.0, 0), draw=wide),
    Case(
        "thresholded_relu_below_0",
        "ThresholdedRelu",
        SHAPE,
        lambda x: F.threshold(x, -0.5, 0),
        {"alpha": -0.5},
    ),
    Case(
        "clip_relu6",
        "Clip",
        SHAPE,
        lambda x, _lo, _hi: F.relu6(x),
        constants={"lo": 0.0, "hi": 6.0},
        draw=wide,
        opsets=(11, 12, 13, 17, 20),
    ),
    Case("clip", "Clip", SHAPE, lambda x, lo, hi: x.clamp(lo, hi), constants={"lo": -0.5, "hi": 0.25}),
    Case(
        "clip_computed",
        "Clip",
        SHAPE,
        lambda x, lo, hi: x.clamp(lo, hi),
        constants={"lo": -0.5, "hi": 0.25},
        computed=("lo", "hi"),
    ),
    Case("clip_low", "Clip", SHAPE, lambda x, lo: x.clamp(lo), constants={"lo": -0.5}),
    Case(
        "clip_high",
        "Clip",
        SHAPE,
        lambda x, hi: x.clamp(max=hi),
        constants={"hi": 0.5},
        order=["x", "", "hi"],
    ),
    Case(
        "clip_infinite_high",
        "Clip",
        SHAPE,
        lambda x, lo, _hi: x.clamp(lo),
        constants={"lo": 0.0, "hi": float("inf")},
    ),
    Case(
        "clip_infinite_low",
        "Clip",
        SHAPE,
        lambda x, _lo, hi: x.clamp(max=hi),
        constants={"lo": float("-inf"), "hi": 0.5},
    ),
    Case(
        "clip_infinite",
        "Clip",
        SHAPE,
        lambda x, _lo, _hi: x * 1,
        constants={"lo": float("-inf"), "hi": float("inf")},
    ),
    Case("clip_nothing", "Clip", SHAPE, lambda x: x * 1),
    Case("hard_sigmoid", "HardSigmoid", SHAPE, lambda x: (0.2 * x + 0.5).clamp(0, 1), draw=wide),
    Case(
        "hard_sigmoid_torch",
        "HardSigmoid",
        SHAPE,
        F.hardsigmoid,
        {"alpha": 1 / 6},
        draw=wide,
        tolerance64=1e-7,  # the attribute is a float32
    ),
    Case("hard_swish", "HardSwish", SHAPE, F.hardswish, draw=wide, opsets=(14, 17, 20, 22), tolerance64=1e-7),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
