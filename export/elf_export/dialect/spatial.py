"""Emitting what a sliding window needs: sizes and pads that the run may tell, padding, cropping, the flipped kernel.

The windows' geometry is in `graph.windows`; n is the number of spatial axes.
"""

from __future__ import annotations

import numpy as np

from elf_export.graph.graph import Array
from elf_export.graph.windows import Window

from .emit import FAR, Ints, ints, positive_part, slice_axes
from .emitter import Emitter


def spatial_shape(ctx: Emitter, x: str, role: str) -> str:
    """int64 (n,): the sizes of `x` behind N and C, constant where they are static."""
    dims = ctx.shape(x)
    if dims is not None and all(isinstance(d, int) for d in dims[2:]):
        return ctx.int64s([d for d in dims[2:] if isinstance(d, int)], role)
    return slice_axes(ctx, ctx.op("Shape", x, role=f"{role}_full"), [2], [FAR], [0], role=role)


def begin_pads(ctx: Emitter, window: Window, x: str) -> str:
    """int64 (n,): padding in front of each axis; computed from the size of `x` under auto_pad SAME.

    total = max((ceil(H / s) - 1) s + extent - H, 0);  begin = total / 2, the larger half for SAME_LOWER
    """
    if window.begin is not None:
        return ctx.int64s(window.begin, "pad_begin")
    size = spatial_shape(ctx, x, "same_size")
    strides = ctx.int64s(window.strides, "same_strides")
    # (ceil(H/s) - 1) s = ((H - 1) / s) s for H >= 1
    minus_one = ctx.op("Sub", size, ctx.int64s([1], "one"), role="same_last")
    starts = ctx.op("Mul", ctx.op("Div", minus_one, strides, role="same_steps"), strides, role="same_starts")
    reach = ctx.op("Add", starts, ctx.int64s(window.extent, "same_extent"), role="same_reach")
    total = positive_part(ctx, ctx.op("Sub", reach, size, role="same_lack"), "same_total")
    if window.same_lower:
        total = ctx.op("Add", total, ctx.int64s([1], "round_up"), role="same_rounded")
    return ctx.op("Div", total, ctx.int64s([2], "two"), role="pad_begin")


def pad_spatial(ctx: Emitter, x: str, like: str, begin: Ints, end: Ints, role: str, fill: float = 0) -> str:
    """Pad the spatial axes of `x` by constants or by computed int64 (n,) vectors, all >= 0."""
    zeros = ctx.int64s([0, 0], f"{role}_nc")
    parts = ints(ctx, begin, f"{role}_begin"), ints(ctx, end, f"{role}_end")
    pads = ctx.op("Concat", zeros, parts[0], zeros, parts[1], role=f"{role}_pads", axis=0)
    return ctx.op("Pad", x, pads, ctx.const(fill, f"{role}_fill", like=like), role=role, mode="constant")


def crop_spatial(ctx: Emitter, x: str, begin: str, size: str, role: str, axes: list[int]) -> str:
    """x[..., begin : begin + size] along the spatial `axes`; begin and size are int64 (n,) values."""
    end = ctx.op("Add", begin, size, role=f"{role}_ends")
    return ctx.op("Slice", x, begin, end, ctx.int64s(axes, f"{role}_axes"), role=role)


def transposed(weight: Array, group: int) -> Array:
    """Kernel of a convolution's transpose: (O, I/g, k...) -> (I, O/g, k...)."""
    out, per_group, *kernel = weight.shape
    swapped = weight.reshape(group, out // group, per_group, *kernel).swapaxes(1, 2)
    return swapped.reshape(group * per_group, out // group, *kernel)


def flipped(weight: Array, group: int) -> Array:
    """Kernel of a stride-1 convolution's adjoint: (O, I/g, k...) -> (I, O/g, k...), each k flipped."""
    return np.ascontiguousarray(np.flip(transposed(weight, group), tuple(range(2, weight.ndim))))
