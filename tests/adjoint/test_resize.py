"""Rule of Resize."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from .oracles import Case, Fixed, check, rows

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 4, 5)}
NO_ROI = Fixed(np.zeros(0, np.float32))  # an input that may be left out from opset 13 on only
LINEAR = {"linear": True, "static_axes": (0, 1)}


def scales(
    name: str, factors: tuple[float, float], function: Any, attrs: dict[str, Any], **more: Any
) -> Case:
    given = np.array([1, 1, *factors], np.float32)
    return Case(
        name, "Resize", SHAPE, lambda x, *_: function(x), attrs, {"roi": NO_ROI, "s": Fixed(given)},
        **{"opsets": (11, 13, 18, 19), **LINEAR, **more},
    )  # fmt: skip


def sizes(name: str, size: tuple[int, int], function: Any, attrs: dict[str, Any], **more: Any) -> Case:
    given = np.array([2, 3, *size])
    return Case(
        name, "Resize", SHAPE, lambda x, *_: function(x), attrs, {"s": given}, order=["x", "", "", "s"],
        **{"opsets": (13, 18, 19), **LINEAR, **more},
    )  # fmt: skip


def zoom(mode: str, size: tuple[int, int], align: bool | None = None) -> Any:
    return lambda x: F.interpolate(x, size=size, mode=mode, align_corners=align)


FLOOR = {"coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
CORNERS = {"coordinate_transformation_mode": "align_corners"}
HALF = {"coordinate_transformation_mode": "pytorch_half_pixel"}
CUBIC = {"mode": "cubic", "cubic_coeff_a": -0.75}

CASES = [
    scales("nearest_2", (2, 2), zoom("nearest", (8, 10)), FLOOR, opsets=range(11, 21)),
    scales("nearest_3_2", (3, 2), zoom("nearest", (12, 10)), FLOOR),
    scales("nearest_2_default", (2, 2), zoom("nearest", (8, 10)), {}),
    scales("nearest_up_1_5", (1.5, 1.5), zoom("nearest", (6, 7)), FLOOR),
    scales("nearest_down", (0.5, 0.5), zoom("nearest", (2, 2)), FLOOR),
    sizes("nearest_sizes", (7, 9), zoom("nearest", (7, 9)), FLOOR),
    sizes("nearest_exact", (7, 9), zoom("nearest-exact", (7, 9)), {"nearest_mode": "round_prefer_ceil"}),
    scales("linear_2", (2, 2), zoom("bilinear", (8, 10), False), {"mode": "linear"}, opsets=range(11, 21)),
    scales("linear_2_torch", (2, 2), zoom("bilinear", (8, 10), False), {"mode": "linear", **HALF}),
    scales("linear_2_corners", (2, 2), zoom("bilinear", (8, 10), True), {"mode": "linear", **CORNERS}),
    scales(
        "linear_down",
        (0.5, 0.5),
        lambda x: F.interpolate(x, scale_factor=0.5, mode="bilinear"),
        {"mode": "linear"},
    ),
    sizes("linear_sizes", (7, 9), zoom("bilinear", (7, 9), False), {"mode": "linear", **HALF}),
    sizes("linear_sizes_corners", (7, 3), zoom("bilinear", (7, 3), True), {"mode": "linear", **CORNERS}),
    sizes("linear_to_one", (1, 5), zoom("bilinear", (1, 5), True), {"mode": "linear", **CORNERS}),
    scales("cubic_2", (2, 2), zoom("bicubic", (8, 10), False), CUBIC, tolerance64=1e-10),
    sizes(
        "cubic_sizes",
        (7, 9),
        zoom("bicubic", (7, 9), False),
        {**CUBIC, **HALF},
        tolerance64=1e-6,
        tolerance32=2e-5,
    ),
    sizes("cubic_corners", (7, 9), zoom("bicubic", (7, 9), True), {**CUBIC, **CORNERS}, tolerance32=2e-5),
    Case(
        "axes",
        "Resize",
        SHAPE,
        lambda x, _s: zoom("bilinear", (8, 10), False)(x),
        {"mode": "linear", "axes": [2, 3]},
        {"s": Fixed(np.array([2, 2], np.float32))},
        order=["x", "", "s"],
        opsets=(18, 19),
        **LINEAR,
    ),
    Case(
        "empty_scales",
        "Resize",
        SHAPE,
        lambda x, *_: zoom("bilinear", (7, 9), False)(x),
        {"mode": "linear"},
        {"roi": NO_ROI, "none": Fixed(np.zeros(0, np.float32)), "s": np.array([2, 3, 7, 9])},
        opsets=(11, 12, 13),
        **LINEAR,
    ),
    Case(
        "line",
        "Resize",
        {"x": (2, 3, 5)},
        lambda x, *_: F.interpolate(x, scale_factor=2),
        FLOOR,
        {"roi": NO_ROI, "s": Fixed(np.array([1, 1, 2], np.float32))},
        opsets=(11, 13, 18, 19),
        linear=True,
    ),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)


# What torch has no word for is held against the runtime's own forward: <A x, s> = <x, A' s> and differences.
SYMMETRIC = [
    scales(
        f"symmetric_{mode}_{f}",
        (f, f),
        torch.abs,
        {"mode": mode, "coordinate_transformation_mode": "half_pixel_symmetric"},
        opsets=(19, 20),
    )
    for mode in ("linear", "nearest")
    for f in (1.7, 0.7)
]
