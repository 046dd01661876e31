"""2x2 max-pooling's adjoint with the gradient in one piece, channels last: the form that suits 8-bit convolutions.

8-bit convolutions run channels last, where rows and columns are interleaved by moving whole pixels: joining two
maps along the channels IS interleaving their columns, once the result is read as twice as many pixels.  So the four
phases (see `phases`) are put together at once, and every convolution behind stays a plain 3x3 one.

All masks are steps of small depthwise convolutions, complements and products of such: what an 8-bit graph
computes without rounding.
"""

from __future__ import annotations

from . import phases
from .gradient import Rectified
from .registry import Context


def max_pool(ctx: Context, grad_y: str) -> str:
    """y = max of each 2x2 window of x;  dx gets dy at the FIRST place in raster order that attains the maximum.

    As `phases.split_max_pool`, with products in place of differences: dy_top = dy (1 - [t_bottom > t_top]).
    """
    x, y = ctx.node.input[0], ctx.node.output[0]
    rectified = phases.is_rectified(ctx, x)
    if rectified and grad_y != y:
        grad_y = ctx.op("Mul", grad_y, phases.positive(ctx, y, "y"), role="dy_positive")
    rows = phases.row_maxima(ctx)
    lower = phases.bottom_wins(ctx, rows)
    joined = []
    for a, name in enumerate(("top", "bottom")):
        wins = lower if a else _complement(ctx, lower, "top_wins")
        part = ctx.op("Mul", grad_y, wins, role=f"dy_{name}")
        right = phases.right_wins(ctx, a)
        left = _complement(ctx, right, f"left_wins_{name}")
        pieces = [
            _channels_last(ctx, ctx.op("Mul", part, mask, role=f"dx_{a}{b}"), f"dx_{a}{b}_nhwc")
            for b, mask in enumerate((left, right))
        ]
        joined.append(_beside(ctx, pieces, f"dx_{name}"))
    # (N, h, 2 W', C): each row of windows with its two rows of pixels one after the other.
    stacked = ctx.op("Concat", *joined, role="dx_stacked", axis=2)
    width = _slice_of_shape(ctx, joined[0], 2, 3, "dx_width")
    shape = ctx.op(
        "Concat", ctx.int64s([0, -1], "keep"), width, ctx.int64s([_channels(ctx)], "channels"),
        role="dx_shape", axis=0,
    )  # fmt: skip
    even = ctx.op("Reshape", stacked, shape, role="dx_even")
    # Rows and columns that no window covers are zero.
    lack = ctx.op(
        "Sub", _slice_of_shape(ctx, x, 2, 4, "size"), _slice_of_shape(ctx, even, 1, 3, "even_size"), role="lack"
    )
    pads = ctx.op("Concat", ctx.int64s([0] * 5, "no_pads"), lack, ctx.int64s([0], "no_pad"), role="pads", axis=0)
    full = ctx.op("Pad", even, pads, ctx.const(0, "fill", like=x), role="dx_nhwc", mode="constant")
    dx = ctx.op("Transpose", full, role="dx", perm=[0, 3, 1, 2])
    return Rectified(dx, x) if rectified else dx


def _complement(ctx: Context, mask: str, role: str) -> str:
    """1 - mask."""
    return phases.depthwise(ctx, mask, [[-1]], [1, 1], role, bias=1.0)


def _channels_last(ctx: Context, value: str, role: str) -> str:
    return ctx.op("Transpose", value, role=role, perm=[0, 2, 3, 1])


def _beside(ctx: Context, columns: list[str], role: str) -> str:
    """Even and odd columns, (N, h, w, C) each, interleaved: (N, h, 2 w, C)."""
    pairs = ctx.op("Concat", *columns, role=f"{role}_pairs", axis=3)
    return ctx.op("Reshape", pairs, ctx.int64s([0, 0, -1, _channels(ctx)], f"{role}_shape"), role=role)


def _channels(ctx: Context) -> int:
    channels = (ctx.shape(ctx.node.input[0]) or [])[1]
    assert isinstance(channels, int), "phases.splits has seen to that"
    return channels


def _slice_of_shape(ctx: Context, value: str, start: int, stop: int, role: str) -> str:
    shape = ctx.op("Shape", value, role=f"{role}_shape")
    bounds = [ctx.int64s([v], f"{role}_{what}") for v, what in ((start, "from"), (stop, "to"), (0, "axis"))]
    return ctx.op("Slice", shape, *bounds, role=role)
