"""Rules of Conv and ConvTranspose."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from .oracles import Case, check, rows
from .stand_ins import transposed

pytestmark = pytest.mark.torch

CONV = [F.conv1d, F.conv2d, F.conv3d]


def weights(*shape: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.random.default_rng(sum(shape)).standard_normal(shape)


def same_pads(size: int, extent: int, stride: int, upper: bool) -> tuple[int, int]:
    total = max((-(-size // stride) - 1) * stride + extent - size, 0)
    small, large = total // 2, total - total // 2
    return (small, large) if upper else (large, small)


def conv(
    name: str, shape: tuple[int, ...], weight: tuple[int, ...], attrs: dict[str, Any] | None = None,
    bias: bool = True, **more: Any,
) -> Case:  # fmt: skip
    """A row for Conv.  `weight`: (O, I/g, k...)."""
    attrs = attrs or {}
    n = len(shape) - 2

    def function(x: torch.Tensor, w: torch.Tensor, *b: torch.Tensor) -> torch.Tensor:
        stride, dilation = attrs.get("strides", [1] * n), attrs.get("dilations", [1] * n)
        pads = attrs.get("pads", [0] * 2 * n)
        sides = [(pads[i], pads[i + n]) for i in range(n)]
        auto = attrs.get("auto_pad", "NOTSET")
        if auto.startswith("SAME"):
            extents = [(k - 1) * d + 1 for k, d in zip(weight[2:], dilation, strict=True)]
            sides = [
                same_pads(s, e, t, auto == "SAME_UPPER") for s, e, t in zip(shape[2:], extents, stride, strict=True)
            ]
        padded = F.pad(x, list(itertools.chain.from_iterable(reversed(sides))))
        return CONV[n - 1](padded, w, *b, stride=stride, dilation=dilation, groups=attrs.get("group", 1))

    constants = {"w": weights(*weight), **({"b": weights(weight[0])} if bias else {})}
    return Case(name, "Conv", {"x": shape}, function, attrs, constants, linear=True, tolerance32=2e-5, **more)


def deconv(
    name: str,
    shape: tuple[int, ...],
    weight: tuple[int, ...],
    attrs: dict[str, Any] | None = None,
    **more: Any,
) -> Case:
    """A row for ConvTranspose.  `weight`: (I, O/g, k...)."""
    attrs = attrs or {}
    n = len(shape) - 2

    def function(x: torch.Tensor, w: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        return transposed(
            x, w, b, stride=attrs.get("strides", [1] * n), pads=attrs.get("pads", [0] * 2 * n),
            rest=attrs.get("output_padding", [0] * n), dilation=attrs.get("dilations", [1] * n),
            group=attrs.get("group", 1), auto_pad=attrs.get("auto_pad", "NOTSET"),
        )  # fmt: skip

    constants = {"w": weights(*weight), "b": weights(weight[1] * attrs.get("group", 1))}
    return Case(name, "ConvTranspose", {"x": shape}, function, attrs, constants, linear=True, tolerance32=2e-5, **more)


PLANE = (2, 4, 7, 9)
SMALL = {"opsets": (11, 17)}

CASES = [
    conv("plain", PLANE, (6, 4, 3, 3), opsets=range(11, 21)),
    conv("no_bias", PLANE, (6, 4, 3, 3), bias=False, **SMALL),
    conv("pads_1", PLANE, (6, 4, 3, 3), {"pads": [1, 1, 1, 1]}),
    conv("pads_asymmetric", PLANE, (6, 4, 3, 4), {"pads": [2, 0, 1, 3]}),
    conv("pads_beyond_kernel", PLANE, (6, 4, 2, 3), {"pads": [3, 2, 0, 4]}),
    conv("one_by_one", PLANE, (6, 4, 1, 1)),
    conv("even_kernel", PLANE, (5, 4, 2, 4), {"pads": [0, 1, 1, 2]}),
    conv("dilated", PLANE, (6, 4, 3, 2), {"dilations": [2, 3], "pads": [2, 1, 2, 1]}),
    conv("groups", PLANE, (6, 2, 3, 3), {"group": 2, "pads": [1, 1, 1, 1]}),
    conv("depthwise", PLANE, (8, 1, 3, 3), {"group": 4, "pads": [1, 1, 1, 1]}),
    conv("stride_2", PLANE, (6, 4, 3, 3), {"strides": [2, 2], "pads": [1, 1, 1, 1]}),
    conv("stride_2_even_size", (2, 4, 8, 6), (6, 4, 3, 3), {"strides": [2, 2], "pads": [1, 1, 1, 1]}, **SMALL),
    conv("stride_beyond_kernel", (2, 4, 11, 10), (6, 4, 2, 1), {"strides": [3, 2]}),
    conv("stride_mixed", PLANE, (6, 4, 3, 3), {"strides": [1, 3], "pads": [1, 0, 0, 1]}),
    conv(
        "stride_groups_dilated",
        (2, 4, 11, 12),
        (6, 2, 3, 3),
        {"strides": [2, 3], "group": 2, "dilations": [2, 1], "pads": [1, 2, 0, 1]},
    ),
    conv("alexnet", (1, 3, 35, 38), (4, 3, 11, 11), {"strides": [4, 4], "pads": [2, 2, 2, 2]}, **SMALL),
    conv("valid", PLANE, (6, 4, 3, 3), {"auto_pad": "VALID", "strides": [2, 1]}, **SMALL),
    *(
        conv(
            f"{auto.lower()}_{h}x{w}_k{k}_s{s}",
            (2, 3, h, w),
            (4, 3, k, k + 1),
            {"auto_pad": auto, "strides": [s, s]},
            **SMALL,
        )
        for auto, (h, w), (k, s) in itertools.product(
            ("SAME_UPPER", "SAME_LOWER"), ((7, 10), (8, 9)), ((3, 1), (2, 2), (3, 2), (5, 3), (2, 3))
        )
    ),
    conv("line", (2, 3, 11), (4, 3, 3), {"pads": [1, 2]}),
    conv("line_stride_3", (2, 3, 11), (4, 3, 4), {"pads": [1, 2], "strides": [3]}),
    conv("volume", (1, 2, 4, 5, 6), (3, 2, 2, 3, 3), {"pads": [0, 1, 1, 1, 0, 1]}),
    conv("volume_stride", (1, 2, 5, 5, 6), (3, 2, 2, 3, 3), {"pads": [0, 1, 1, 1, 0, 1], "strides": [2, 1, 2]}),
    deconv("up", (2, 4, 3, 4), (4, 3, 2, 2), {"strides": [2, 2]}, opsets=range(11, 21)),
    deconv(
        "up_pads",
        (2, 4, 3, 4),
        (4, 3, 3, 4),
        {"strides": [2, 2], "pads": [1, 0, 0, 1], "output_padding": [1, 1]},
    ),
    deconv("up_stride_1", (2, 4, 3, 4), (4, 3, 3, 3), {"pads": [1, 1, 1, 1]}),
    deconv("up_groups", (2, 4, 3, 4), (4, 3, 3, 3), {"strides": [2, 3], "group": 2}),
    deconv("up_dilated", (2, 4, 3, 4), (4, 3, 3, 2), {"strides": [2, 1], "dilations": [2, 3]}),
    deconv("up_gap", (2, 4, 3, 4), (4, 3, 1, 2), {"strides": [3, 3], "output_padding": [2, 0]}),
    deconv(
        "up_same_upper",
        (2, 4, 3, 4),
        (4, 3, 4, 3),
        {"strides": [2, 2], "auto_pad": "SAME_UPPER"},
    ),
    deconv(
        "up_same_lower",
        (2, 4, 3, 4),
        (4, 3, 4, 3),
        {"strides": [2, 2], "auto_pad": "SAME_LOWER"},
    ),
    deconv("up_line", (2, 4, 5), (4, 3, 3), {"strides": [2], "output_padding": [1]}),
    deconv("up_volume", (1, 2, 3, 3, 2), (2, 3, 2, 2, 3), {"strides": [2, 2, 1]}),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
