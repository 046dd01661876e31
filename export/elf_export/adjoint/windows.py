"""Windows that slide: strides, dilations and pads of Conv and the pools, and shapes known only at run time.

The number of spatial axes is called n.  Along one axis, window m of an input of size H padded by
(begin, end) starts at padded position ``m * stride`` and looks at offsets ``0, d, 2d ... (k-1)d``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elf_export.graph.graph import Array

from .emit import FAR, Ints, ints, positive_part, slice_axes
from .registry import Context


@dataclass(frozen=True)
class Window:
    """The sliding window of one node; all tuples have n entries."""

    kernel: tuple[int, ...]
    strides: tuple[int, ...]
    dilations: tuple[int, ...]
    begin: tuple[int, ...] | None  # None: auto_pad SAME_* with a stride, known at run time only
    end: tuple[int, ...]  # an upper bound where `begin` is None
    same_lower: bool = False
    ceil: bool = False

    @property
    def extent(self) -> tuple[int, ...]:
        """Pixels that the window spans: (k - 1) d + 1."""
        return tuple((k - 1) * d + 1 for k, d in zip(self.kernel, self.dilations, strict=True))

    @property
    def padded(self) -> bool:
        return self.begin is None or any(self.begin) or any(self.end) or self.ceil

    @property
    def spatial_axes(self) -> list[int]:
        return list(range(2, 2 + len(self.kernel)))


def window_of(ctx: Context, kernel: Sequence[int]) -> Window:
    """The window of a Conv or pool node, auto_pad resolved as far as it can be without the input's size."""
    n = len(kernel)
    a = ctx.attrs
    strides = tuple(a.get("strides", [1] * n))
    dilations = tuple(a.get("dilations", [1] * n))
    pads = list(a.get("pads", [0] * 2 * n))
    auto = a.get("auto_pad", "NOTSET")
    begin: tuple[int, ...] | None = tuple(pads[:n])
    end = tuple(pads[n:])
    extent = [(k - 1) * d + 1 for k, d in zip(kernel, dilations, strict=True)]
    if auto == "VALID":
        begin = end = (0,) * n
    elif auto in ("SAME_UPPER", "SAME_LOWER"):
        totals = _same_totals(ctx, extent, strides)
        if totals is None:
            begin, end = None, tuple(e - 1 for e in extent)
        else:
            small, large = tuple(t // 2 for t in totals), tuple(t - t // 2 for t in totals)
            begin, end = (small, large) if auto == "SAME_UPPER" else (large, small)
    ceil = bool(a.get("ceil_mode", 0))
    return Window(tuple(kernel), strides, dilations, begin, end, auto == "SAME_LOWER", ceil)


def _same_totals(ctx: Context, extent: Sequence[int], strides: Sequence[int]) -> list[int] | None:
    """Total padding per axis under auto_pad SAME, None where it depends on a size that is not static."""
    sizes = (ctx.shape(ctx.node.input[0]) or [None] * (2 + len(extent)))[2:]
    totals = []
    for e, s, size in zip(extent, strides, sizes, strict=True):
        if isinstance(size, int):
            totals.append(max((math.ceil(size / s) - 1) * s + e - size, 0))
        elif s == 1:
            totals.append(e - 1)
        else:
            return None
    return totals


def spatial_shape(ctx: Context, x: str, role: str) -> str:
    """int64 (n,): the sizes of `x` behind N and C, constant where they are static."""
    dims = ctx.shape(x)
    if dims is not None and all(isinstance(d, int) for d in dims[2:]):
        return ctx.int64s([d for d in dims[2:] if isinstance(d, int)], role)
    return slice_axes(ctx, ctx.op("Shape", x, role=f"{role}_full"), [2], [FAR], [0], role=role)


def begin_pads(ctx: Context, window: Window, x: str) -> str:
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


def pad_spatial(ctx: Context, x: str, like: str, begin: Ints, end: Ints, role: str, fill: float = 0) -> str:
    """Pad the spatial axes of `x` by constants or by computed int64 (n,) vectors, all >= 0."""
    zeros = ctx.int64s([0, 0], f"{role}_nc")
    parts = ints(ctx, begin, f"{role}_begin"), ints(ctx, end, f"{role}_end")
    pads = ctx.op("Concat", zeros, parts[0], zeros, parts[1], role=f"{role}_pads", axis=0)
    return ctx.op("Pad", x, pads, ctx.const(fill, f"{role}_fill", like=like), role=role, mode="constant")


def crop_spatial(ctx: Context, x: str, begin: str, size: str, role: str, axes: list[int]) -> str:
    """x[..., begin : begin + size] along the spatial `axes`; begin and size are int64 (n,) values."""
    end = ctx.op("Add", begin, size, role=f"{role}_ends")
    return ctx.op("Slice", x, begin, end, ctx.int64s(axes, f"{role}_axes"), role=role)


def flipped(weight: Array, group: int) -> Array:
    """Kernel of a stride-1 convolution's adjoint: (O, I/g, k...) -> (I, O/g, k...), each k flipped."""
    out, per_group, *kernel = weight.shape
    swapped = weight.reshape(group, out // group, per_group, *kernel).swapaxes(1, 2)
    joined = swapped.reshape(group * per_group, out // group, *kernel)
    return np.ascontiguousarray(np.flip(joined, tuple(range(2, joined.ndim))))
