"""Rules of MaxPool and AveragePool."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from .oracles import NEVER, Case, apart, check, rows
from .runs import run_ort, with_adjoint
from .test_conv import same_pads

pytestmark = pytest.mark.torch

MAX = [F.max_pool1d, F.max_pool2d, F.max_pool3d]


def framed(x: torch.Tensor, sides: Sequence[tuple[int, int]], fill: float) -> torch.Tensor:
    return F.pad(x, list(itertools.chain.from_iterable(reversed(sides))), value=fill)


def sides_of(shape: Sequence[int], attrs: dict[str, Any]) -> list[tuple[int, int]]:
    """Padding in front and behind, what ceil_mode needs behind included."""
    n = len(shape) - 2
    kernel, stride = attrs["kernel_shape"], attrs.get("strides", [1] * n)
    dilation, pads = attrs.get("dilations", [1] * n), attrs.get("pads", [0] * 2 * n)
    extents = [(k - 1) * d + 1 for k, d in zip(kernel, dilation, strict=True)]
    auto = attrs.get("auto_pad", "NOTSET")
    sides = []
    for i in range(n):
        if auto.startswith("SAME"):
            sides.append(same_pads(shape[2 + i], extents[i], stride[i], auto == "SAME_UPPER"))
            continue
        p, q = pads[i], pads[i + n]
        if attrs.get("ceil_mode", 0):
            steps = -(-(shape[2 + i] + p + q - extents[i]) // stride[i])
            if steps * stride[i] >= shape[2 + i] + p:  # a window must start inside, or in front
                steps -= 1
            q = max(q, steps * stride[i] + extents[i] - shape[2 + i] - p)
        sides.append((p, q))
    return sides


def max_pool(name: str, shape: Sequence[int], attrs: dict[str, Any], **more: Any) -> Case:
    n = len(shape) - 2

    def function(x: torch.Tensor) -> torch.Tensor:
        padded = framed(x, sides_of(shape, attrs), float("-inf"))
        return MAX[n - 1](
            padded,
            attrs["kernel_shape"],
            attrs.get("strides", [1] * n),
            dilation=attrs.get("dilations", [1] * n),
        )

    return Case(f"max_{name}", "MaxPool", {"x": shape}, function, attrs, **more)


def average_pool(name: str, shape: Sequence[int], attrs: dict[str, Any], **more: Any) -> Case:
    n = len(shape) - 2
    kernel, stride = attrs["kernel_shape"], attrs.get("strides", [1] * n)

    def function(x: torch.Tensor) -> torch.Tensor:
        """Sum-pool, by a depthwise convolution, over the number of pixels that count."""
        sides = sides_of(shape, attrs)
        ones = torch.ones((1, 1, *shape[2:]), dtype=x.dtype)
        if attrs.get("count_include_pad", 0):
            pads = attrs.get("pads", [0] * 2 * n)
            stated = [(pads[i], pads[i + n]) for i in range(n)] if "auto_pad" not in attrs else sides
            ones = framed(ones, stated, 1)
            sides_of_ones = [(0, b[1] - a[1]) for a, b in zip(stated, sides, strict=True)]
        else:
            sides_of_ones = sides
        box = torch.ones((1, 1, *kernel), dtype=x.dtype)
        conv = [F.conv1d, F.conv2d, F.conv3d][n - 1]
        dilation = attrs.get("dilations", [1] * n)
        counts = conv(framed(ones, sides_of_ones, 0), box, stride=stride, dilation=dilation)
        flat = framed(x, sides, 0).flatten(0, 1).unsqueeze(1)
        sums = conv(flat, box, stride=stride, dilation=dilation)
        return sums.reshape(*shape[:2], *sums.shape[2:]) / counts

    return Case(f"average_{name}", "AveragePool", {"x": shape}, function, attrs, linear=True, **more)


PLANE = (2, 3, 7, 9)
SMALL = {"opsets": (11, 17)}
# The reference evaluator's max pool knows neither SAME_LOWER nor torch's order of the Indices.
IN_FLOAT32 = {"reference_from": NEVER, "draw": apart}
BOTH = [
    ("vgg", (2, 3, 8, 6), {"kernel_shape": [2, 2], "strides": [2, 2]}, {"opsets": range(11, 21)}),
    ("vgg_odd", PLANE, {"kernel_shape": [2, 2], "strides": [2, 2]}, {}),
    ("alexnet", (2, 3, 9, 12), {"kernel_shape": [3, 3], "strides": [2, 2]}, {}),
    ("xception", PLANE, {"kernel_shape": [3, 3], "strides": [2, 2], "pads": [1, 1, 1, 1]}, {}),
    ("stride_1", PLANE, {"kernel_shape": [3, 2]}, {}),
    ("asymmetric", PLANE, {"kernel_shape": [3, 4], "strides": [2, 3], "pads": [0, 2, 1, 1]}, {}),
    ("gap", (2, 3, 11, 10), {"kernel_shape": [2, 1], "strides": [3, 2]}, {}),
    ("gap_pads", (2, 3, 11, 10), {"kernel_shape": [2, 2], "strides": [3, 4], "pads": [1, 0, 1, 1]}, {}),
    ("mixed_strides", PLANE, {"kernel_shape": [2, 3], "strides": [1, 2]}, {}),
    ("line", (2, 3, 11), {"kernel_shape": [3], "strides": [2], "pads": [1, 0]}, {}),
    ("volume", (1, 2, 5, 4, 6), {"kernel_shape": [2, 2, 3], "strides": [2, 2, 2]}, {}),
    (
        "volume_pads",
        (1, 2, 5, 4, 6),
        {"kernel_shape": [2, 3, 3], "strides": [2, 1, 2], "pads": [0, 1, 1, 1, 0, 1]},
        {},
    ),
    ("ceil", PLANE, {"kernel_shape": [2, 2], "strides": [2, 2], "ceil_mode": 1}, {}),
    ("ceil_overlap", (2, 3, 8, 10), {"kernel_shape": [3, 3], "strides": [2, 2], "ceil_mode": 1}, {}),
    ("ceil_pads", (2, 3, 33, 8), {"kernel_shape": [2, 2], "strides": [2, 2], "pads": [1] * 4, "ceil_mode": 1}, SMALL),
    ("ceil_gap", (2, 3, 5, 7), {"kernel_shape": [1, 2], "strides": [3, 4], "ceil_mode": 1}, SMALL),
    ("ceil_exact", (2, 3, 7, 9), {"kernel_shape": [3, 3], "strides": [2, 2], "ceil_mode": 1}, SMALL),
    *(
        (
            f"{auto.lower()}_{h}x{w}_k{k}_s{s}",
            (2, 3, h, w),
            {"kernel_shape": [k, k], "strides": [s, s], "auto_pad": auto},
            SMALL,
        )
        for auto, (h, w), (k, s) in itertools.product(
            ("SAME_UPPER", "SAME_LOWER"), ((7, 10), (8, 9)), ((2, 2), (3, 2), (3, 1), (5, 3))
        )
    ),
]

CASES = [
    *(
        max_pool(name, shape, attrs, **more, **(IN_FLOAT32 if attrs.get("auto_pad") == "SAME_LOWER" else {}))
        for name, shape, attrs, more in BOTH
    ),
    *(average_pool(name, shape, attrs, **more) for name, shape, attrs, more in BOTH),
    max_pool("dilated", (2, 3, 9, 11), {"kernel_shape": [2, 3], "strides": [1, 2], "dilations": [3, 2]}),
    max_pool("dilated_pads", (2, 3, 9, 11), {"kernel_shape": [3, 2], "dilations": [2, 2], "pads": [1, 1, 2, 0]}),
    max_pool(
        "indices",
        (2, 3, 8, 6),
        {"kernel_shape": [2, 2], "strides": [2, 2]},
        outputs=2,
        **SMALL,
        **IN_FLOAT32,
    ),
    average_pool(
        "dilated",
        (2, 3, 9, 11),
        {"kernel_shape": [2, 3], "strides": [1, 2], "dilations": [3, 2]},
        opsets=(19, 20),
    ),
    *(
        average_pool(f"counting_{name}", shape, {**attrs, "count_include_pad": 1}, **SMALL)
        for name, shape, attrs in (
            ("xception", PLANE, {"kernel_shape": [3, 3], "strides": [2, 2], "pads": [1, 1, 1, 1]}),
            ("asymmetric", PLANE, {"kernel_shape": [3, 4], "strides": [2, 3], "pads": [0, 2, 1, 1]}),
            ("same", PLANE, {"kernel_shape": [3, 3], "strides": [2, 2], "auto_pad": "SAME_UPPER"}),
        )
    ),
    average_pool(
        "counting_ceil",
        (2, 3, 8, 10),
        {
            "kernel_shape": [3, 3],
            "strides": [2, 2],
            "pads": [1, 1, 1, 1],
            "ceil_mode": 1,
            "count_include_pad": 1,
        },
        opsets=(19, 20),
    ),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)


@pytest.mark.parametrize(
    "attrs",
    [
        {"kernel_shape": [2, 2], "strides": [2, 2]},
        {"kernel_shape": [3, 3], "strides": [2, 2], "pads": [1, 1, 1, 1]},
        {"kernel_shape": [3, 3], "strides": [1, 1]},
        {"kernel_shape": [3, 2], "strides": [2, 1], "dilations": [2, 1]},
    ],
    ids=["disjoint", "overlapping_pads", "stride_1", "dilated"],
)
def test_a_tie_goes_to_the_first_in_raster_order(attrs: dict[str, Any]) -> None:
    """Flat blocks, as strong JPEG compression makes them: ties in most windows, above, at and below zero."""
    rng = np.random.default_rng(7)
    x = np.repeat(np.repeat(rng.integers(-2, 3, (2, 3, 4, 5)), 2, 2), 2, 3)[:, :, :7, :9].astype(np.float32)
    case = max_pool("ties", x.shape, attrs)
    leaf = torch.tensor(x, requires_grad=True)
    y = F.max_pool2d(
        leaf, attrs["kernel_shape"], attrs["strides"], attrs.get("pads", [0])[0], attrs.get("dilations", 1)
    )
    seed = rng.standard_normal(tuple(y.shape)).astype(np.float32)
    (expected,) = torch.autograd.grad(y, leaf, torch.from_numpy(seed))
    both = with_adjoint(case.model(17, dynamic=True, dtype=np.float32), "x")
    _, dx = run_ort(both, {"x": x, "seed": seed})
    np.testing.assert_allclose(dx, expected.numpy(), rtol=0, atol=1e-5)
    assert np.array_equal(dx != 0, expected.numpy() != 0)
