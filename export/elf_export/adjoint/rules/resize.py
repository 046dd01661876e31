"""Adjoint of Resize: a separable linear map, y = A_1 x along each axis in turn."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import onnx

from elf_export.adjoint.interpolation import COORDINATES, MODES, given_scales, interpolation_matrix, nearest_places
from elf_export.adjoint.registry import Context, Gradients, adjoint

from .slicing import along_axis


def _supports(ctx: Context) -> str | None:
    a = ctx.attrs
    mode, coordinates = a.get("mode", "nearest"), a.get("coordinate_transformation_mode", "half_pixel")
    if mode not in MODES:
        return f"mode {mode!r}"
    if coordinates not in COORDINATES:
        return f"coordinate_transformation_mode {coordinates!r}; supported: {', '.join(COORDINATES)}"
    if a.get("antialias", 0):
        return "antialias=1"
    if mode == "cubic" and a.get("exclude_outside", 0):
        return "exclude_outside=1"
    if a.get("keep_aspect_ratio_policy", "stretch") != "stretch":
        return f"keep_aspect_ratio_policy {a['keep_aspect_ratio_policy']!r}"
    if ctx.graph.rank(ctx.node.input[0]) is None:
        return "unknown rank of the input"
    return None


@adjoint("Resize", supports=_supports)
def resize(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y_i = sum over taps t of w_t(c_i) x[clamp(floor(c_i) + t)] along an axis;  dx = dy A.   A: (K, D)

    c_i is where output i lies in x (the coordinate_transformation_mode); nearest has one tap, linear two,
    cubic four.  A is built when the graph runs, from the sizes of that run, and ONNX Runtime folds it where
    they are static.  Nearest by a whole factor s, an upsampling layer, is a sum over blocks of s instead.
    """
    x, rank = node.input[0], ctx.rank(node.input[0])
    axes = [int(a) % rank for a in ctx.attrs.get("axes", range(rank))]
    factors = _block_factors(ctx, axes)
    if factors is not None:
        return [_block_sums(ctx, x, grad_y, [factors.get(a, 1) for a in range(2, rank)])]
    dx = grad_y
    for i, axis in enumerate(axes):
        if not _copies(ctx, axis, i):
            dx = along_axis(ctx, dx, interpolation_matrix(ctx, axis, i), axis, rank, f"dx_{axis}")
    return [dx]


def _copies(ctx: Context, axis: int, position: int) -> bool:
    """Whether the node leaves an axis as it is, as far as one can tell before it runs."""
    scales = given_scales(ctx)
    if scales:
        value = ctx.value(scales)
        if value is not None:
            return bool(value[position] == 1)
    else:
        own, out = (ctx.shape(v) or [None] * (axis + 1) for v in (ctx.node.input[0], ctx.node.output[0]))
        if own[axis] is not None and own[axis] == out[axis]:
            return True
    # Batch and channels are interpolated by nobody; the runtime refuses it.
    return axis < 2 and ctx.attrs.get("mode", "nearest") != "nearest"


def _block_factors(ctx: Context, axes: Sequence[int]) -> dict[int, int] | None:
    """axis -> s, if the node repeats every pixel of a spatial axis s times; None otherwise."""
    scales, rank = ctx.value(given_scales(ctx)), ctx.rank(ctx.node.input[0])
    if scales is None or ctx.attrs.get("mode", "nearest") != "nearest" or not 3 <= rank <= 5:
        return None
    factors = {}
    for axis, scale in zip(axes, scales.tolist(), strict=True):
        if scale == 1:
            continue
        if axis < 2 or scale != int(scale) or scale < 1:
            return None
        # Which pixel is nearest repeats every s outputs: a few periods tell.
        factor = int(scale)
        places = nearest_places(ctx, factor, 4 * factor)
        if places is None or not np.array_equal(np.maximum(places, 0), np.arange(4 * factor) // factor):
            return None
        factors[axis] = factor
    return factors


def _block_sums(ctx: Context, x: str, grad_y: str, factors: list[int]) -> str:
    """Sums of `grad_y` over blocks: their means, times their size."""
    area = math.prod(factors)
    if area == 1:
        return grad_y
    pooled = ctx.op("AveragePool", grad_y, role="block_mean", kernel_shape=factors, strides=factors)
    return ctx.op("Mul", pooled, ctx.const(area, "area", like=x), role="dx")
