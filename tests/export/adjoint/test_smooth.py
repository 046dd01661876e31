"""Rules of the smooth activations."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F

from .oracles import Case, check, rows, wide

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 5, 7)}

CASES = [
    Case("sigmoid", "Sigmoid", SHAPE, torch.sigmoid, draw=wide),
    Case("tanh", "Tanh", SHAPE, torch.tanh, draw=wide),
    Case("elu", "Elu", SHAPE, F.elu, draw=wide),
    Case("elu_alpha", "Elu", SHAPE, lambda x: F.elu(x, 1.5), {"alpha": 1.5}),
    Case("selu", "Selu", SHAPE, F.selu, draw=wide, tolerance64=1e-7),  # its constants are float32 attributes
    Case("celu", "Celu", SHAPE, lambda x: F.celu(x, 1.5), {"alpha": 1.5}, opsets=(12, 17, 20), single_only=True),
    Case("softplus", "Softplus", SHAPE, lambda x: F.softplus(x, threshold=1e9), draw=wide),
    Case("softsign", "Softsign", SHAPE, F.softsign, draw=wide),
    Case("mish", "Mish", SHAPE, F.mish, draw=wide, opsets=(18, 20, 22)),
    Case("swish", "Swish", SHAPE, F.silu, draw=wide, opsets=(24,)),
    Case("swish_alpha", "Swish", SHAPE, lambda x: x * torch.sigmoid(1.5 * x), {"alpha": 1.5}, opsets=(24,)),
    Case("gelu", "Gelu", SHAPE, F.gelu, draw=wide, opsets=(20, 21)),
    Case(
        "gelu_tanh",
        "Gelu",
        SHAPE,
        lambda x: F.gelu(x, approximate="tanh"),
        {"approximate": "tanh"},
        draw=wide,
        opsets=(20, 21),
    ),
    Case("erf", "Erf", SHAPE, torch.erf),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
