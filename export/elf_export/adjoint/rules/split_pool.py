"""The adjoint of a 2x2 max-pool, as the four phases of its gradient (see `phases`)."""

from __future__ import annotations

import numpy as np

from elf_export.adjoint import depthwise
from elf_export.adjoint.depthwise import every_second
from elf_export.adjoint.emit import step
from elf_export.adjoint.gradient import Extent, Phases
from elf_export.adjoint.interleave import known_channels
from elf_export.adjoint.registry import Context
from elf_export.graph.windows import Window


def splits(ctx: Context, window: Window) -> bool:
    """Whether a pool's gradient can be held in phases: 2x2 windows side by side, in 2-D, of known channels."""
    x = ctx.node.input[0]
    plain = (window.kernel, window.strides, window.dilations) == ((2, 2), (2, 2), (1, 1)) and not window.padded
    return plain and known_channels(ctx.graph, x) is not None and ctx.dtype(x).kind == "f"


def split_max_pool(ctx: Context, grad_y: str) -> Phases:
    """y = max of each 2x2 window of x;  dx gets dy at the FIRST place in raster order that attains the maximum.

    Rows first: t = max over each row's pair, so that y = max(t_top, t_bottom).  The bottom row wins if it is
    strictly larger, and within a row the right place if it is: on ties the top row, and its left place, have it.

        dy_bottom = dy [t_bottom > t_top],  dy_top = dy - dy_bottom;   likewise dy_right, dy_left of each row

    Where x is a ReLU's output, dy is cleared first where y = 0: the places left over are then all positive, and
    that ReLU's own mask has nothing more to do.
    """
    x = ctx.node.input[0]
    rectified = is_rectified(ctx, x)
    before = ctx.graph.producers().get(grad_y)
    if before is not None and before.op_type == "Transpose":
        # Put together by `whole`, outside the blocked layout: back into it at once, for all that follows.
        grad_y = depthwise.convolve(ctx, grad_y, [[1]], [1, 1], "dy_blocked")
    if rectified:
        grad_y = cleared(ctx, grad_y)
    rows = row_maxima(ctx)
    bottom = ctx.op("Mul", grad_y, bottom_wins(ctx, rows), role="dy_bottom")
    top = depthwise.minus(ctx, grad_y, bottom, "dy_top")
    top_right = ctx.op("Mul", top, right_wins(ctx, 0), role="dx_01")
    bottom_right = ctx.op("Mul", bottom, right_wins(ctx, 1), role="dx_11")
    top_left = depthwise.minus(ctx, top, top_right, "dx_00")
    bottom_left = depthwise.minus(ctx, bottom, bottom_right, "dx_10")
    pieces = (top_left, top_right, bottom_left, bottom_right)
    return Phases(pieces, x, zero_unless_positive=x if rectified else None)


def is_rectified(ctx: Context, x: str) -> bool:
    """Whether a ReLU makes x."""
    producer = ctx.graph.producers().get(x)
    return producer is not None and producer.op_type == "Relu"


def cleared(ctx: Context, grad_y: str) -> str:
    """dy [y > 0], y being the node's result; dy itself where it is y, the seed, of a pool behind a ReLU."""
    y = ctx.node.output[0]
    return grad_y if grad_y == y else ctx.op("Mul", grad_y, step(ctx, y, "positive"), role="dy_positive")


def row_maxima(ctx: Context) -> str:
    """The maximum of each pair of neighbours in a row of the node's input, (N, C, H, W // 2)."""
    return ctx.op("MaxPool", ctx.node.input[0], role="row_maxima", kernel_shape=[1, 2], strides=[1, 2])


def bottom_wins(ctx: Context, rows: str) -> str:
    """Of each window: is its bottom row's maximum the larger one?  (N, C, h, w)."""
    return depthwise.step(ctx, rows, [[-1], [1]], [2, 1], "bottom_wins")


def right_wins(ctx: Context, row: int) -> str:
    """Of each window's top row (0) or bottom row (1): is the right value the larger one?  (N, C, h, w)."""
    taps, above, below = every_second(row, Extent.FLOOR)
    role = f"right_wins_{('top', 'bottom')[row]}"
    difference = np.outer(taps, [-1, 1])
    return depthwise.step(ctx, ctx.node.input[0], difference, [2, 2], role, (above, 0, below, 0), dilations=[2, 1])
