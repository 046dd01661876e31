"""The matrix of Resize along one axis: weights of the inputs in each output, built when the graph runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from onnx import TensorProto, helper

from elf_export.dialect.emit import Ints, arithmetic, as_number, ints, scalar, size_of, slice_axes, unsqueeze
from elf_export.graph.graph import Array

from .registry import Context

MODES = ("nearest", "linear", "cubic")
COORDINATES = (
    "half_pixel", "half_pixel_symmetric", "pytorch_half_pixel", "align_corners", "asymmetric",
    "tf_half_pixel_for_nn",
)  # fmt: skip


def interpolation_matrix(ctx: Context, axis: int, position: int) -> str:
    """(K, D): the weight of input j in output i.  K and D are the sizes of y and x along `axis`.

    `position` is the axis's among those that the node's scales speak of.
    """
    tag, x = f"axis_{axis}", ctx.node.input[0]
    mode = ctx.attrs.get("mode", "nearest")
    size = size_of(ctx, x, axis, f"{tag}_size")
    # Nearest rounds a coordinate, so it must be the runtime's own number: that is float32.  The other modes
    # are continuous in it, and take x's type.
    dtype = np.dtype(np.float32) if mode == "nearest" else ctx.dtype(x)
    coordinates = _coordinates(ctx, axis, position, dtype)
    if mode == "nearest":
        first = _round(ctx, coordinates, dtype, tag)
        weights: list[str | None] = [None]
        offsets = [0]
    else:
        floor = ctx.op("Floor", coordinates, role=f"{tag}_floor")
        fraction = ctx.op("Sub", coordinates, floor, role=f"{tag}_fraction")
        first = floor
        offsets = [0, 1] if mode == "linear" else [-1, 0, 1, 2]
        weights = [_weight(ctx, fraction, t, mode, x, f"{tag}_weight_{t}") for t in offsets]
    base = ctx.op("Cast", first, role=f"{tag}_base", to=TensorProto.INT64)
    last = ints(ctx, arithmetic(ctx, "Sub", size, [1], f"{tag}_last"), f"{tag}_last_int")
    zero = ctx.int64s([0], f"{tag}_none")
    start, one = (
        ctx.const(np.array(0, np.int64), f"{tag}_start"),
        ctx.const(np.array(1, np.int64), f"{tag}_step"),
    )
    columns = ctx.op("Range", start, scalar(ctx, size, f"{tag}_columns_end"), one, role=f"{tag}_columns")
    taps = []
    for t, weight in zip(offsets, weights, strict=True):
        place = ctx.op("Add", base, ctx.int64s([t], f"{tag}_tap_{t}"), role=f"{tag}_place_{t}")
        place = ctx.op("Where", ctx.op("Less", place, zero), zero, place, role=f"{tag}_raised_{t}")
        place = ctx.op("Where", ctx.op("Greater", place, last), last, place, role=f"{tag}_clamped_{t}")
        hit = ctx.op("Equal", unsqueeze(ctx, place, [1], f"{tag}_rows_{t}"), columns, role=f"{tag}_hit_{t}")
        tap = as_number(ctx, hit, x, f"{tag}_mask_{t}")
        if weight is not None:
            tap = ctx.op("Mul", tap, unsqueeze(ctx, weight, [1], f"{tag}_w_{t}"), role=f"{tag}_tap_{t}_weighted")
        taps.append(tap)
    return taps[0] if len(taps) == 1 else ctx.op("Sum", *taps, role=f"{tag}_matrix")


def given_scales(ctx: Context) -> str:
    """Name of the node's scales, empty if it has sizes instead; before opset 13 the scales are then (0,)."""
    scales = ctx.input(2)
    return scales if scales and ctx.shape(scales) != [0] else ""


def _coordinates(ctx: Context, axis: int, position: int, dtype: np.dtype[Any]) -> str:
    """(K,): where each output lies in x along `axis`, in `dtype`."""
    tag, x, y = f"axis_{axis}", ctx.node.input[0], ctx.node.output[0]
    mode = ctx.attrs.get("coordinate_transformation_mode", "half_pixel")
    kind = helper.np_dtype_to_tensor_dtype(dtype)

    def number(value: float, role: str) -> str:
        return ctx.const(value, f"{tag}_{role}", dtype=dtype)

    def real(size: Ints, role: str) -> str:
        return ctx.op("Cast", scalar(ctx, size, f"{tag}_{role}_int"), role=f"{tag}_{role}", to=kind)

    def op(name: str, a: str, b: str, role: str) -> str:
        return ctx.op(name, a, b, role=f"{tag}_{role}")

    out, own = (
        real(size_of(ctx, y, axis, f"{tag}_out"), "out"),
        real(size_of(ctx, x, axis, f"{tag}_in"), "in"),
    )
    one, half = number(1, "unit"), number(0.5, "half")
    i = ctx.op("Range", number(0, "first"), out, one, role=f"{tag}_i")
    if mode == "align_corners":
        steps = op("Max", op("Sub", out, one, "out_steps"), one, "steps")  # a single output lies at 0
        return op("Div", op("Mul", i, op("Sub", own, one, "in_steps"), "scaled"), steps, "c")
    scales = given_scales(ctx)
    if scales:
        single = slice_axes(ctx, scales, [position], [position + 1], [0], f"{tag}_given_scale")
        scale = ctx.op("Cast", single, role=f"{tag}_scale", to=kind)
    else:
        scale = op("Div", out, own, "scale")
    if mode == "asymmetric":
        return op("Div", i, scale, "c")
    centre = op("Div", op("Add", i, half, "middle"), scale, "centre")
    if mode == "tf_half_pixel_for_nn":
        return centre
    if mode == "half_pixel_symmetric":
        # The output's centre is the input's, although the output's size was rounded down.  The shift comes
        # before the half is taken off: the runtime's order, and nearest depends on the last bit.
        adjustment = op("Div", out, op("Mul", scale, own, "exact_out"), "adjustment")
        shift = op("Mul", op("Mul", own, half, "in_centre"), op("Sub", one, adjustment, "rounded"), "shift")
        centre = op("Add", shift, centre, "centre_shifted")
    c = op("Sub", centre, half, "c")
    if mode == "pytorch_half_pixel":
        return ctx.op("Where", op("Greater", out, one, "many"), c, number(0, "only"), role=f"{tag}_c_or_0")
    return c


def _round(ctx: Context, c: str, dtype: np.dtype[Any], tag: str) -> str:
    rounding = ctx.attrs.get("nearest_mode", "round_prefer_floor")
    if rounding in ("floor", "ceil"):
        return ctx.op(rounding.capitalize(), c, role=f"{tag}_nearest")
    half = ctx.const(0.5, f"{tag}_tie", dtype=dtype)
    if rounding == "round_prefer_floor":
        return ctx.op("Ceil", ctx.op("Sub", c, half, role=f"{tag}_below"), role=f"{tag}_nearest")
    return ctx.op("Floor", ctx.op("Add", c, half, role=f"{tag}_above"), role=f"{tag}_nearest")


def nearest_places(ctx: Context, scale: int, count: int) -> Array | None:
    """The nearest input of the first `count` outputs by a whole `scale`; None if it depends on the sizes."""
    mode = ctx.attrs.get("coordinate_transformation_mode", "half_pixel")
    if mode == "align_corners":
        return None
    c = np.arange(count) / scale if mode == "asymmetric" else (np.arange(count) + 0.5) / scale
    if mode not in ("asymmetric", "tf_half_pixel_for_nn"):
        c = c - 0.5
    rounding = ctx.attrs.get("nearest_mode", "round_prefer_floor")
    if rounding in ("floor", "ceil"):
        return np.floor(c) if rounding == "floor" else np.ceil(c)
    return np.ceil(c - 0.5) if rounding == "round_prefer_floor" else np.floor(c + 0.5)


def _weight(ctx: Context, fraction: str, tap: int, mode: str, like: str, role: str) -> str:
    """Weight of the pixel at floor(c) + tap, from the fraction f = c - floor(c).

    linear: 1 - d, d = |f - tap|.   cubic, Keys' kernel with coefficient a:
    (a + 2) d^3 - (a + 3) d^2 + 1 for d <= 1,  a d^3 - 5 a d^2 + 8 a d - 4 a for 1 < d < 2
    """
    shifted = ctx.op("Sub", fraction, ctx.const(tap, f"{role}_tap", like=like), role=f"{role}_shifted")
    d = ctx.op("Abs", shifted, role=f"{role}_d")
    if mode == "linear":
        return ctx.op("Sub", ctx.const(1, f"{role}_one", like=like), d, role=role)
    a = ctx.attrs.get("cubic_coeff_a", -0.75)
    coefficients = [a + 2, -(a + 3), 0, 1] if tap in (0, 1) else [a, -5 * a, 8 * a, -4 * a]
    total = ctx.const(coefficients[0], f"{role}_c3", like=like)
    for power, c in zip((2, 1, 0), coefficients[1:], strict=True):  # Horner
        total = ctx.op("Mul", total, d, role=f"{role}_times_{power}")
        total = ctx.op("Add", total, ctx.const(c, f"{role}_c{power}", like=like), role=f"{role}_h{power}")
    return total
