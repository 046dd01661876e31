"""Rule of Resize."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from .oracles import NEVER, Case, Fixed, check, rows

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 4, 5)}
NO_ROI = Fixed(np.zeros(0, np.float32))  # an input that may be left out from opset 13 on only
LINEAR = {"linear": True, "static_axes": (0, 1)}


def sampled(factors: tuple[float, float], place: Any, rounding: str | None = None) -> Any:
    """What torch.nn.functional has no word for: linear, or nearest by a `rounding`, along both axes."""

    def along(x: torch.Tensor, axis: int, scale: np.float32) -> torch.Tensor:
        d = x.shape[axis]
        k = int(np.floor(scale * d))
        c = np.float32(place(np.arange(k, dtype=np.float32), np.float32(k), np.float32(d), scale))

        def at(places: Any) -> torch.Tensor:
            return x.index_select(axis, torch.from_numpy(np.clip(places, 0, d - 1).astype(np.int64)))

        if rounding is not None:
            return at(ROUNDINGS[rounding](c))
        low = np.floor(c)
        share = torch.from_numpy((c - low).astype(np.float64)).reshape([-1] + [1] * (3 - axis))
        return at(low) * (1 - share) + at(low + 1) * share

    return lambda x: along(along(x, 2, np.float32(factors[0])), 3, np.float32(factors[1]))


def scales(name: str, factors: tuple[float, float], function: Any, attrs: dict[str, Any], **more: Any) -> Case:
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


# Where output i of k lies in an input of d pixels, at scale s: ONNX's formulas, in the runtime's float32.
PLACES: dict[str, Any] = {
    "asymmetric": lambda i, _k, _d, s: i / s,
    "half_pixel": lambda i, _k, _d, s: (i + 0.5) / s - 0.5,
    "tf_half_pixel_for_nn": lambda i, _k, _d, s: (i + 0.5) / s,
    "align_corners": lambda i, k, d, _s: i * (d - 1) / (k - 1),
    "half_pixel_symmetric": lambda i, k, d, s: d / 2 * (1 - k / (s * d)) + (i + 0.5) / s - 0.5,
}
ROUNDINGS: dict[str, Any] = {
    "floor": np.floor,
    "ceil": np.ceil,
    "round_prefer_floor": lambda c: np.ceil(c - 0.5),
    "round_prefer_ceil": lambda c: np.floor(c + 0.5),
}


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
    *(
        scales(
            f"{mode}_{rounding}_{h}x{w}",
            (h, w),
            sampled((h, w), PLACES[mode], rounding),
            {"coordinate_transformation_mode": mode, "nearest_mode": rounding},
            opsets=(19,) if mode == "half_pixel_symmetric" else (11, 18),
            # The reference evaluator aligns with a corner that is not rounded to a whole pixel.
            reference_from=NEVER if mode == "align_corners" else 0,
        )
        for mode in ("asymmetric", "half_pixel", "half_pixel_symmetric", "align_corners")
        for rounding in ("floor", "ceil", "round_prefer_floor", "round_prefer_ceil")
        for h, w in ((2, 3), (1.7, 0.7))
    ),
    *(
        scales(
            f"linear_{mode}_{h}x{w}",
            (h, w),
            sampled((h, w), PLACES[mode]),
            {"coordinate_transformation_mode": mode, "mode": "linear"},
            tolerance64=1e-6,  # the scale is a float32
            opsets=(19,) if mode == "half_pixel_symmetric" else (11, 18),
            # The reference evaluator aligns with a corner that is not rounded to a whole pixel.
            reference_from=NEVER if mode == "align_corners" else 0,
        )
        for mode in ("asymmetric", "half_pixel", "half_pixel_symmetric", "align_corners")
        for h, w in ((3, 1), (1.7, 0.7))
    ),
    scales(
        "tensorflow",
        (1.7, 0.7),
        sampled((1.7, 0.7), PLACES["tf_half_pixel_for_nn"], "floor"),
        {"coordinate_transformation_mode": "tf_half_pixel_for_nn", "nearest_mode": "floor"},
        opsets=(11, 12),
        reference_from=NEVER,  # unknown to the reference evaluator
    ),
    sizes("sizes_computed", (7, 9), zoom("bilinear", (7, 9), False), {"mode": "linear"}, computed=("s",)),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
