"""Differences, masks and sums as depthwise convolutions, in the blocked layout in which ONNX Runtime convolves.

Masks are HardSigmoid(1e30 d - 1) of a depthwise convolution that takes the difference d: ONNX Runtime runs the two
as one operator, in the blocked layout.  It is exactly 1 for d > 0 and 0 for d <= 0, d itself being the correctly
rounded difference of two values; a positive d below 2e-30 would not be 1.  The 1 is there because OpenVINO takes an
offset of 0 for an absent one, whose default is 0.5; in half precision too it is a number, and not 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from . import emit
from .gradient import Extent
from .interleave import channels_of
from .registry import Context

FEW = 16  # channels of one block of the blocked layout (AVX-512); a convolution to fewer pays for all of them


def convolve(
    ctx: Context,
    x: str,
    kernel: npt.ArrayLike,
    strides: list[int],
    role: str,
    pads: Sequence[int] = (0, 0, 0, 0),
    bias: float | None = None,
    dilations: list[int] | None = None,
) -> str:
    """Each channel of x, which has as many as the node's input, convolved with the same small kernel.

    `pads` are the rows of zeros above x, the columns on its left, the rows below and the columns on its right.
    """
    like = ctx.node.input[0]
    channels = channels_of(ctx.graph, like)
    size = list(np.shape(kernel))
    inputs = [x, ctx.const(np.broadcast_to(kernel, (channels, 1, *size)), f"{role}_kernel", like=like)]
    if bias is not None:
        inputs.append(ctx.const(np.broadcast_to(bias, channels), f"{role}_bias", like=like))
    return ctx.op(
        "Conv", *inputs, role=role,
        kernel_shape=size, strides=strides, group=channels, pads=list(pads), dilations=dilations,
    )  # fmt: skip


def step(
    ctx: Context,
    x: str,
    kernel: npt.ArrayLike,
    strides: list[int],
    role: str,
    pads: Sequence[int] = (0, 0, 0, 0),
    dilations: list[int] | None = None,
) -> str:
    """[d > 0] with d = `convolve` of the same arguments."""
    difference = convolve(ctx, x, kernel, strides, f"{role}_difference", pads, dilations=dilations)
    return emit.step(ctx, difference, role)


def minus(ctx: Context, a: str, b: str, role: str) -> str:
    """a - b as a sum, which the convolution that negates b does in place."""
    negated = convolve(ctx, b, [[-1]], [1, 1], f"{role}_minus")
    return ctx.op("Add", negated, a, role=role)


def every_second(phase: int, extent: Extent) -> tuple[list[int], int, int]:
    """Along one axis: the taps, 2 places apart, and the zeros before and behind that give phase 0 or 1 every 2 places.

    Of the places in between none is read: they are half of a map that has long left the caches.
    """
    if phase:
        # Places 2 i - 1 and 2 i + 1, of which the second counts.
        return [0, 1], 1, {Extent.FLOOR: 0, Extent.CEIL: 1, Extent.BEYOND: 2}[extent]
    # The last place of an odd number of them is left out by a tap behind it.
    return ([1, 0], 0, 1) if extent is Extent.FLOOR else ([1], 0, int(extent is Extent.BEYOND))
