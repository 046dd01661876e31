"""Where the gradient of a Clip passes."""

from __future__ import annotations

import numpy as np

from . import depthwise
from .interleave import known_channels
from .registry import Context


def room(ctx: Context) -> str | None:
    """(y - low) (high - y) of a Clip, positive just where its gradient passes; None if nothing bounds y."""
    y, low, high = ctx.node.output[0], _bound(ctx, 1, -np.inf), _bound(ctx, 2, np.inf)
    above = below = ""
    if low:
        bound = ctx.value(low)
        above = y if bound is not None and not bound.any() else ctx.op("Sub", y, low, role="above_low")
    if high:
        below = _below(ctx, y, high)
    return ctx.op("Mul", above, below, role="room") if above and below else above or below or None


def _bound(ctx: Context, index: int, nothing: float) -> str:
    """Name of a Clip's bound; empty if it is absent, or a constant of the value that bounds nothing."""
    name = ctx.input(index)
    value = ctx.value(name)
    return "" if value is not None and (value == nothing).all() else name


def _below(ctx: Context, y: str, high: str) -> str:
    """high - y; of a map of known channels in the blocked layout, which Sub leaves."""
    bound = ctx.value(high)
    if ctx.channels_last or bound is None or known_channels(ctx.graph, ctx.node.input[0]) is None:
        return ctx.op("Sub", high, y, role="below_high")
    return depthwise.convolve(ctx, y, [[-1]], [1, 1], "below_high", bias=float(bound))
