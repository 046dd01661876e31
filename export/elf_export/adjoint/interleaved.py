"""2x2 max-pooling's adjoint with the gradient in one piece, channels last: the form that suits 8-bit convolutions.

8-bit convolutions run channels last, where rows and columns are interleaved by moving whole pixels: joining two
maps along the channels IS interleaving their columns, once the result is read as twice as many pixels.  So the four
phases (see `phases`) are put together at once, and every convolution behind stays a plain 3x3 one.

All masks are steps of small depthwise convolutions, complements and products of such: what an 8-bit graph
computes without rounding.
"""

from __future__ import annotations

from . import joining, phases
from .gradient import Phases, Rectified
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
    pieces = []
    for a, name in enumerate(("top", "bottom")):
        wins = lower if a else _complement(ctx, lower, "top_wins")
        part = ctx.op("Mul", grad_y, wins, role=f"dy_{name}")
        right = phases.right_wins(ctx, a)
        left = _complement(ctx, right, f"left_wins_{name}")
        pieces += [ctx.op("Mul", part, mask, role=f"dx_{a}{b}") for b, mask in enumerate((left, right))]
    dx = joining.whole(ctx.graph, Phases(tuple(pieces), x))
    return Rectified(dx, x) if rectified else dx


def _complement(ctx: Context, mask: str, role: str) -> str:
    """1 - mask."""
    return phases.depthwise(ctx, mask, [[-1]], [1, 1], role, bias=1.0)
