"""The adjoint of a convolution every 2 pixels: a convolution for each phase of its input's gradient.

    y[i] = sum over t of W[t] x[2 i + t - p],   dx[2 j + a] = sum over s of W[a + p - 2 s]^T dy[j + s]

A ConvTranspose is that too; ONNX Runtime's multiplies out all windows first and adds them up then, outside the blocked
layout in which it convolves.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from elf_export.graph import Array

from .geometry import Window
from .gradient import Phases
from .phases import FEW, PHASES
from .registry import Context


def suits(ctx: Context, window: Window, weight: Array | None, group: int) -> bool:
    """Whether `conv` can do this Conv, and faster than a ConvTranspose: a first layer's, to few channels."""
    channels = (ctx.shape(ctx.node.input[0]) or [None, None])[1]
    if ctx.channels_last or weight is None or group > 1 or window.begin is None or not isinstance(channels, int):
        return False
    plain = (window.strides, window.dilations) == ((2, 2), (1, 1)) and 4 * weight.shape[1] <= FEW
    return plain and all(
        begin < k and begin + end <= k
        for k, begin, end in zip(window.kernel, window.begin, window.end, strict=True)
    )


def conv(ctx: Context, grad_y: str, window: Window, weight: Array) -> Phases:
    """dx in phases, side by side in one piece that one convolution makes.   weight: (O, I, k, k)"""
    assert window.begin is not None, "suits has seen to that"
    outputs, inputs = weight.shape[:2]
    shifts = [_shifts(k, p) for k, p in zip(window.kernel, window.begin, strict=True)]
    kernel = np.zeros((4, inputs, outputs, *map(len, shifts)), weight.dtype)
    for phase, (a, b) in enumerate(PHASES):
        for (row, sy), (column, sx) in itertools.product(*map(enumerate, shifts)):
            ty, tx = a + window.begin[0] - 2 * sy, b + window.begin[1] - 2 * sx
            if 0 <= ty < window.kernel[0] and 0 <= tx < window.kernel[1]:
                kernel[phase, :, :, row, column] = weight[:, :, ty, tx].T
    kernel = kernel.reshape(4 * inputs, *kernel.shape[2:])
    # h windows belong to x of 2 (h - 1) + k - p - q rows, or one more, which none reaches: so many j beyond h.
    edges = zip(window.kernel, window.begin, window.end, strict=True)
    beyond = [math.ceil((k - p - q + 1) / 2) - 1 for k, p, q in edges]
    pads = [-s[0] for s in shifts] + [more + s[-1] for more, s in zip(beyond, shifts, strict=True)]
    weights = ctx.const(kernel, "weight")
    piece = ctx.op("Conv", grad_y, weights, role="dx_all", kernel_shape=list(kernel.shape[2:]), pads=pads)
    return Phases((piece,), ctx.node.input[0], margin=1, clean=False)


def _shifts(size: int, pad: int) -> list[int]:
    """Along one axis: all shifts s at which a phase reads a tap, a row of integers."""
    return [s for s in range(-size, size + 1) if any(0 <= a + pad - 2 * s < size for a in (0, 1))]
