"""Rules of the ops that only reshape, reorder or convert."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from onnx import TensorProto

from .oracles import NEVER, Case, check, rows

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 4, 6)}


def depth_to_space_dcr(x: torch.Tensor) -> torch.Tensor:
    n, c, h, w = x.shape
    return x.reshape(n, 2, 2, c // 4, h, w).permute(0, 3, 4, 1, 5, 2).reshape(n, c // 4, 2 * h, 2 * w)


def space_to_depth(x: torch.Tensor) -> torch.Tensor:
    n, c, h, w = x.shape
    return x.reshape(n, c, h // 2, 2, w // 2, 2).permute(0, 3, 5, 1, 2, 4).reshape(n, 4 * c, h // 2, w // 2)


CASES = [
    Case("identity", "Identity", SHAPE, lambda x: x * 1, linear=True),
    Case("dropout", "Dropout", SHAPE, lambda x: x * 1, linear=True, opsets=(11, 12, 13, 17, 22)),
    Case(
        "dropout_inputs",
        "Dropout",
        SHAPE,
        lambda x, *_: x * 1,
        linear=True,
        outputs=2,
        constants={"ratio": 0.5, "training": np.array(False)},
        opsets=(12, 13, 22),
    ),
    Case(
        "cast_same",
        "Cast",
        SHAPE,
        lambda x: x * 1,
        {"to": TensorProto.FLOAT},
        reference_from=NEVER,  # it casts to float32 in any model
        linear=True,
    ),
    Case(
        "cast_like",
        "CastLike",
        SHAPE,
        lambda x, _l: x * 1,
        constants={"l": np.zeros(1)},
        opsets=(15, 19, 20),
        linear=True,
    ),
    Case(
        "reshape",
        "Reshape",
        SHAPE,
        lambda x, _s: x.reshape(2, 12, 6),
        constants={"s": np.array([0, -1, 6])},
        linear=True,
        opsets=(11, 13, 14, 19),
    ),
    Case("flatten", "Flatten", SHAPE, lambda x: x.reshape(2, -1), linear=True),
    Case("flatten_2", "Flatten", SHAPE, lambda x: x.reshape(6, -1), {"axis": -2}, linear=True),
    Case(
        "squeeze_11",
        "Squeeze",
        {"x": (2, 1, 4, 1)},
        lambda x: x.reshape(2, 4),
        {"axes": [1, 3]},
        opsets=(11, 12),
        linear=True,
    ),
    Case(
        "squeeze_13",
        "Squeeze",
        {"x": (2, 1, 4, 1)},
        lambda x, _a: x.reshape(2, 4),
        constants={"a": np.array([1, -1])},
        opsets=(13, 17, 20),
        linear=True,
    ),
    Case(
        "unsqueeze_11",
        "Unsqueeze",
        SHAPE,
        lambda x: x.reshape(2, 1, 3, 4, 6),
        {"axes": [1]},
        opsets=(11, 12),
        linear=True,
    ),
    Case(
        "unsqueeze_13",
        "Unsqueeze",
        SHAPE,
        lambda x, _a: x.reshape(2, 1, 3, 4, 6, 1),
        constants={"a": np.array([1, -1])},
        opsets=(13, 17, 20),
        linear=True,
    ),
    Case(
        "expand",
        "Expand",
        {"x": (3, 1, 4)},
        lambda x, _s: x.expand(2, 3, 5, 4),
        constants={"s": np.array([2, 3, 5, 4])},
        linear=True,
        dynamic_from=13,
    ),
    Case(
        "expand_not",
        "Expand",
        {"x": (3, 4)},
        lambda x, _s: x.expand(3, 4),
        constants={"s": np.array([1, 1])},
        linear=True,
        dynamic_from=13,
    ),
    Case(
        "tile",
        "Tile",
        {"x": (2, 1, 4, 3)},
        lambda x, _r: x.repeat(1, 3, 2, 2),
        constants={"r": np.array([1, 3, 2, 2])},
        linear=True,
    ),
    Case(
        "tile_not",
        "Tile",
        {"x": (2, 3)},
        lambda x, _r: x.repeat(1, 1),
        constants={"r": np.array([1, 1])},
        linear=True,
    ),
    Case(
        "tile_computed",
        "Tile",
        {"x": (2, 3, 4)},
        lambda x, _r: x.repeat(2, 1, 3),
        constants={"r": np.array([2, 1, 3])},
        computed=["r"],
        linear=True,
        opsets=(13, 17, 20),
    ),
    Case("transpose", "Transpose", SHAPE, lambda x: x.permute(2, 0, 3, 1), {"perm": [2, 0, 3, 1]}, linear=True),
    Case("transpose_default", "Transpose", SHAPE, lambda x: x.permute(3, 2, 1, 0), linear=True),
    Case(
        "depth_to_space_dcr",
        "DepthToSpace",
        {"x": (2, 12, 3, 2)},
        depth_to_space_dcr,
        {"blocksize": 2},
        linear=True,
    ),
    Case(
        "depth_to_space_crd",
        "DepthToSpace",
        {"x": (2, 12, 3, 2)},
        lambda x: F.pixel_shuffle(x, 2),
        {"blocksize": 2, "mode": "CRD"},
        static_axes=(1,),
        linear=True,
    ),
    Case(
        "depth_to_space_crd_3",
        "DepthToSpace",
        {"x": (2, 18, 3, 2)},
        lambda x: F.pixel_shuffle(x, 3),
        {"blocksize": 3, "mode": "CRD"},
        static_axes=(1,),
        linear=True,
    ),
    Case(
        "space_to_depth",
        "SpaceToDepth",
        {"x": (2, 3, 4, 6)},
        space_to_depth,
        {"blocksize": 2},
        linear=True,
        opsets=(11, 13, 17),
    ),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
