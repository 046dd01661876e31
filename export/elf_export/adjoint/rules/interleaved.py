"""Max-pooling's adjoint with the gradient in one piece, interleaved channels last.

Channels last, rows and columns are interleaved by moving whole pixels: joining two maps along the channels IS
interleaving their columns, once the result is read as twice as many pixels.  8-bit convolutions run so.  For them the
four phases of a 2x2 pool (see `phases`) are put together at once, and every convolution behind stays a plain 3x3 one.
3x3 windows every 2 pixels, the other usual pool, go the same way one axis at a time, for float convolutions too.

All masks are steps of small depthwise convolutions, complements and products of such: what an 8-bit graph
computes without rounding.
"""

from __future__ import annotations

import numpy as np

from elf_export.adjoint import depthwise, interleave
from elf_export.adjoint.gradient import Phases, Rectified
from elf_export.adjoint.registry import Context
from elf_export.graph.windows import Window

from . import split_pool


def max_pool(ctx: Context, grad_y: str) -> str:
    """y = max of each 2x2 window of x;  dx gets dy at the FIRST place in raster order that attains the maximum.

    As `split_pool.split_max_pool`, with products in place of differences: dy_top = dy (1 - [t_bottom > t_top]).
    """
    x = ctx.node.input[0]
    rectified = split_pool.is_rectified(ctx, x)
    if rectified:
        grad_y = split_pool.cleared(ctx, grad_y)
    rows = split_pool.row_maxima(ctx)
    lower = split_pool.bottom_wins(ctx, rows)
    pieces = []
    for a, name in enumerate(("top", "bottom")):
        wins = lower if a else _complement(ctx, lower, "top_wins")
        part = ctx.op("Mul", grad_y, wins, role=f"dy_{name}")
        right = split_pool.right_wins(ctx, a)
        left = _complement(ctx, right, f"left_wins_{name}")
        pieces += [ctx.op("Mul", part, mask, role=f"dx_{a}{b}") for b, mask in enumerate((left, right))]
    dx = interleave.whole(ctx.graph, Phases(tuple(pieces), x))
    return Rectified(dx, x) if rectified else dx


# -- windows that overlap --------------------------------------------------------------------------------------------


def overlaps(ctx: Context, window: Window) -> bool:
    """Whether `overlapping_max_pool` can do this MaxPool: 3x3 windows every 2 pixels, in 2-D, of known channels.

    Zeros in the padding compete with the values in a window.  They lose where it matters if those are a ReLU's.
    """
    x = ctx.node.input[0]
    plain = (window.kernel, window.strides, window.dilations) == ((3, 3), (2, 2), (1, 1))
    known = interleave.known_channels(ctx.graph, x) is not None and ctx.dtype(x).kind == "f"
    reach = window.begin is not None and max(window.begin + window.end) <= 1
    return plain and known and reach and (not window.padded or split_pool.is_rectified(ctx, x))


def overlapping_max_pool(ctx: Context, grad_y: str, window: Window) -> str:
    """y = max of 3x3 windows of x every 2 pixels;  dx gets dy at the FIRST place in raster order that attains it.

    The maximum is one over rows of t, the maxima along them.  So the gradient goes from y to the first row of t that
    attains y, where two windows may meet in one row, and from there to the first place in that row of x.
    """
    x = ctx.node.input[0]
    assert window.begin is not None, "checked by overlaps"
    rectified = split_pool.is_rectified(ctx, x)
    if rectified:
        grad_y = split_pool.cleared(ctx, grad_y)
    (top, left), (bottom, right) = window.begin, window.end
    ceil = 1 if window.ceil else None
    rows = ctx.op(
        "MaxPool", x, role="row_maxima", kernel_shape=[1, 3], strides=[1, 2], pads=[0, left, 0, right], ceil_mode=ceil
    )
    # A convolution has no ceil_mode: one more row of padding, or column, gives it as many windows.
    more = int(window.ceil)
    dt = _to_winners(ctx, grad_y, rows, 2, (top, bottom + more), "rows")
    dx = _to_winners(ctx, dt, x, 3, (left, right + more), "columns")
    return Rectified(dx, x) if rectified else dx


def _to_winners(ctx: Context, grad: str, v: str, axis: int, pads: tuple[int, int], role: str) -> str:
    """The gradient of maxima of three along one axis, every 2 pixels of v: v's shape, to the first that attains it.

    taken_2 = dy [v_2 > v_0] [v_2 > v_1],  rest = dy - taken_2
    taken_1 = rest [v_1 > v_0],            taken_0 = rest - taken_1
    """
    beats = [_beats(ctx, v, axis, pads, f"{role}_{a}_beats_{b}", a, b) for a, b in ((2, 0), (2, 1), (1, 0))]
    last = ctx.op("Mul", *beats[:2], role=f"{role}_last_wins")
    taken_2 = ctx.op("Mul", grad, last, role=f"{role}_taken_2")
    rest = ctx.op("Mul", grad, _complement(ctx, last, f"{role}_last_loses"), role=f"{role}_rest")
    taken_1 = ctx.op("Mul", rest, beats[2], role=f"{role}_taken_1")
    taken_0 = ctx.op("Mul", rest, _complement(ctx, beats[2], f"{role}_first_wins"), role=f"{role}_taken_0")
    # Even places are the first of one window and the last of the one before.
    along = axis - 1  # channels last
    first, second, third = (
        _shifted(ctx, piece, along, i // 2, f"{role}_{i}") for i, piece in enumerate((taken_0, taken_1, taken_2))
    )
    even = ctx.op("Add", first, third, role=f"{role}_even")
    join = interleave.columns if axis == 3 else interleave.rows
    channels = interleave.channels_of(ctx.graph, ctx.node.input[0])
    joined = join(ctx.graph, (even, second), channels, ctx.name(f"{role}_joined"))
    size = interleave.slice_of_shape(ctx.graph, v, axis, axis + 1, ctx.name(f"{role}_size"))
    start = ctx.int64s([pads[0]], f"{role}_start")
    stop = ctx.op("Add", size, start, role=f"{role}_stop") if pads[0] else size
    part = ctx.op("Slice", joined, start, stop, ctx.int64s([along], f"{role}_axis"), role=f"{role}_nhwc")
    return interleave.channels_first(ctx.graph, part, ctx.name(f"d{role}"))


def _beats(ctx: Context, v: str, axis: int, pads: tuple[int, int], role: str, a: int, b: int) -> str:
    """[v_a > v_b] for each window of three."""
    kernel, (begin, end) = np.zeros(3), pads
    kernel[a], kernel[b] = 1, -1
    if axis == 2:
        return depthwise.step(ctx, v, kernel[:, None], [2, 1], role, (begin, 0, end, 0))
    return depthwise.step(ctx, v, kernel[None], [1, 2], role, (0, begin, 0, end))


def _shifted(ctx: Context, piece: str, axis: int, by: int, role: str) -> str:
    """(N, C, h, w) as (N, h, w, C), with one more place along that axis: a zero in front (by = 1) or behind (0)."""
    last = interleave.channels_last(ctx.graph, piece, ctx.name(f"{role}_nhwc"))
    pads = [0] * 8
    pads[axis + (0 if by else 4)] = 1
    fill = ctx.const(0, f"{role}_fill", like=ctx.node.input[0])
    return ctx.op("Pad", last, ctx.int64s(pads, f"{role}_pads"), fill, role=f"{role}_shifted", mode="constant")


def _complement(ctx: Context, mask: str, role: str) -> str:
    """1 - mask."""
    return depthwise.convolve(ctx, mask, [[-1]], [1, 1], role, bias=1.0)
