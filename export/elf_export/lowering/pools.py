"""Max-pooling's gradient for the usual windows, row by row: 2x2 side by side, and 3x3 every 2 pixels.

A window's maximum is the larger one of its rows' maxima.  So the gradient goes to a row first, and from there to a
place in it.  On ties the first row and the first place have it, which is the first place in raster order.  All masks
are steps of small depthwise convolutions, complements and products of such.

requires : `is_split` or `overlaps`; dy zero where y is, where padding needs it.
"""

from __future__ import annotations

import numpy as np

from elf_export.graph.windows import Window

from . import depthwise, interleave
from .phases import Extent, every_second
from .site import Site


def is_split(site: Site, window: Window) -> bool:
    """Whether windows are 2x2 side by side, in 2-D, of known channels."""
    plain = (window.kernel, window.strides, window.dilations) == ((2, 2), (2, 2), (1, 1)) and not window.padded
    return plain and site.channels is not None and site.dtype(site.like).kind == "f"


def overlaps(site: Site, window: Window, rectified: bool) -> bool:
    """Whether windows are 3x3 every 2 pixels, in 2-D, of known channels.

    Where they are padded, a convolution pads with zeros, which lose only to what is positive: `rectified`, x is a
    ReLU's output, and the gradient zero where all of a window is.
    """
    plain = (window.kernel, window.strides, window.dilations) == ((3, 3), (2, 2), (1, 1))
    known = site.channels is not None and site.dtype(site.like).kind == "f"
    reach = window.begin is not None and max(window.begin + window.end) <= 1
    return plain and known and reach and (not window.padded or rectified)


def split(site: Site, dy: str, by_masks: bool) -> tuple[str, ...]:
    """The four phases of a 2x2 max-pool's gradient.  With t the maxima over each row's pair:

        dy_bottom = dy [t_bottom > t_top],  dy_top = dy - dy_bottom;   likewise dx_right and dx_left of each row

    `by_masks`, for 8 bits, which round no product with a mask: dy_top = dy (1 - [t_bottom > t_top]).
    """

    def parts(total: str, second_wins: str, first: str, second: str) -> tuple[str, str]:
        won = site.op("Mul", total, second_wins, role=second)
        if not by_masks:
            return depthwise.minus(site, total, won, first), won
        first_wins = site.own("Complement", second_wins, role=f"{first}_wins")
        return site.op("Mul", total, first_wins, role=first), won

    top, bottom = parts(dy, bottom_wins(site), "dy_top", "dy_bottom")
    upper = parts(top, right_wins(site, 0), "dx_00", "dx_01")
    return *upper, *parts(bottom, right_wins(site, 1), "dx_10", "dx_11")


def bottom_wins(site: Site) -> str:
    """Of each window: is its bottom row's maximum the larger one?  (N, C, h, w)."""
    rows = site.op("MaxPool", site.like, role="row_maxima", kernel_shape=[1, 2], strides=[1, 2])
    return depthwise.step(site, rows, [[-1], [1]], [2, 1], "bottom_wins")


def right_wins(site: Site, row: int) -> str:
    """Of each window's top row (0) or bottom row (1): is the right value the larger one?  (N, C, h, w)."""
    taps, above, below = every_second(row, Extent.FLOOR)
    role, difference = f"right_wins_{('top', 'bottom')[row]}", np.outer(taps, [-1, 1])
    return depthwise.step(site, site.like, difference, [2, 2], role, (above, 0, below, 0), dilations=[2, 1])


# -- windows that overlap --------------------------------------------------------------------------------------------


def overlapping(site: Site, dy: str, window: Window) -> str:
    """dx of 3x3 windows every 2 pixels: dt of t, the maxima along the rows, and dx from there.

    The gradient goes from y to the first row of t that attains y, where two windows may meet in one row, and from there
    to the first place in that row of x.
    """
    assert window.begin is not None, "checked by overlaps"
    (top, left), (bottom, right) = window.begin, window.end
    ceil = 1 if window.ceil else None
    rows = site.op(
        "MaxPool", site.like, role="row_maxima", kernel_shape=[1, 3], strides=[1, 2], pads=[0, left, 0, right],
        ceil_mode=ceil,
    )  # fmt: skip
    # A convolution has no ceil_mode: one more row of padding, or column, gives it as many windows.
    more = int(window.ceil)
    dt = _to_winners(site, dy, rows, 2, (top, bottom + more), "rows")
    return _to_winners(site, dt, site.like, 3, (left, right + more), "columns")


def _to_winners(site: Site, grad: str, v: str, axis: int, pads: tuple[int, int], role: str) -> str:
    """The gradient of maxima of three along one axis, every 2 pixels of v: v's shape, to the first that attains it.

    taken_2 = dy [v_2 > v_0] [v_2 > v_1],  rest = dy - taken_2
    taken_1 = rest [v_1 > v_0],            taken_0 = rest - taken_1
    """
    beats = [_beats(site, v, axis, pads, f"{role}_{a}_beats_{b}", a, b) for a, b in ((2, 0), (2, 1), (1, 0))]
    last = site.op("Mul", *beats[:2], role=f"{role}_last_wins")
    taken_2 = site.op("Mul", grad, last, role=f"{role}_taken_2")
    rest = site.op("Mul", grad, site.own("Complement", last, role=f"{role}_last_loses"), role=f"{role}_rest")
    taken_1 = site.op("Mul", rest, beats[2], role=f"{role}_taken_1")
    taken_0 = site.op("Mul", rest, site.own("Complement", beats[2], role=f"{role}_first_wins"), role=f"{role}_taken_0")
    # Even places are the first of one window and the last of the one before.
    along = axis - 1  # channels last
    first, second, third = (
        _shifted(site, piece, along, i // 2, f"{role}_{i}") for i, piece in enumerate((taken_0, taken_1, taken_2))
    )
    even = site.op("Add", first, third, role=f"{role}_even")
    join = interleave.columns if axis == 3 else interleave.rows
    joined = join(site, (even, second), f"{role}_joined")
    size = interleave.slice_of_shape(site, v, axis, axis + 1, f"{role}_size")
    start = site.int64s([pads[0]], f"{role}_start")
    stop = site.op("Add", size, start, role=f"{role}_stop") if pads[0] else size
    part = site.op("Slice", joined, start, stop, site.int64s([along], f"{role}_axis"), role=f"{role}_nhwc")
    return interleave.channels_first(site, part, f"d{role}")


def _beats(site: Site, v: str, axis: int, pads: tuple[int, int], role: str, a: int, b: int) -> str:
    """[v_a > v_b] for each window of three."""
    kernel, (begin, end) = np.zeros(3), pads
    kernel[a], kernel[b] = 1, -1
    if axis == 2:
        return depthwise.step(site, v, kernel[:, None], [2, 1], role, (begin, 0, end, 0))
    return depthwise.step(site, v, kernel[None], [1, 2], role, (0, begin, 0, end))


def _shifted(site: Site, piece: str, axis: int, by: int, role: str) -> str:
    """(N, C, h, w) as (N, h, w, C), with one more place along that axis: a zero in front (by = 1) or behind (0)."""
    last = interleave.channels_last(site, piece, f"{role}_nhwc")
    pads = [0] * 8
    pads[axis + (0 if by else 4)] = 1
    fill = site.const(0, f"{role}_fill", like=site.like)
    return site.op("Pad", last, site.int64s(pads, f"{role}_pads"), fill, role=f"{role}_shifted", mode="constant")
