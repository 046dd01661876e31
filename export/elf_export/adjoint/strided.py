"""The adjoint of a convolution every 2 pixels: a convolution for each phase of its input's gradient.

    y[i] = sum over t of W[t] x[2 i + t - p],   dx[2 j + a] = sum over s of W[a + p - 2 s]^T dy[j + s]

A ConvTranspose is that too; ONNX Runtime's multiplies out all windows first and adds them up then, outside the blocked
layout in which it convolves.
"""

from __future__ import annotations

import itertools

import numpy as np

from elf_export.graph import Array

from .geometry import Window
from .gradient import Extent, Phases
from .joining import known_channels
from .phases import FEW, PHASES
from .registry import Context


def suits(ctx: Context, window: Window, weight: Array | None, group: int) -> bool:
    """Whether `conv` can do this Conv, and faster than a ConvTranspose: to an image's few channels, or depthwise."""
    channels = known_channels(ctx.graph, ctx.node.input[0])
    if ctx.channels_last or weight is None or window.begin is None or channels is None:
        return False
    plain = (window.strides, window.dilations) == ((2, 2), (1, 1)) and all(
        begin < k and begin + end <= k
        for k, begin, end in zip(window.kernel, window.begin, window.end, strict=True)
    )
    if group == 1:
        return plain and 4 * channels <= FEW
    # Every phase has a tap.
    return plain and group == channels == weight.shape[0] and min(window.kernel) > 1 and _extent(window) is not None


def conv(ctx: Context, grad_y: str, window: Window, weight: Array, group: int) -> Phases:
    """dx in phases, side by side in one piece that one convolution makes; of a depthwise one in four.

    weight: (O, I, k, k)
    """
    assert window.begin is not None, "suits has seen to that"
    places = list(zip(window.kernel, window.begin, strict=True))
    if group == 1:
        # (4 I, O, rows, columns): one kernel for all phases.
        shifts = [_shifts(k, p, (0, 1)) for k, p in places]
        kernel = np.concatenate([_kernel(weight, window.begin, phase, shifts).swapaxes(0, 1) for phase in PHASES])
        pieces = [_piece(ctx, grad_y, window, kernel, shifts, 1, "all")]
    else:
        pieces = []
        for phase in PHASES:
            shifts = [_shifts(k, p, (a,)) for (k, p), a in zip(places, phase, strict=True)]
            kernel = _kernel(weight, window.begin, phase, shifts)
            pieces.append(_piece(ctx, grad_y, window, kernel, shifts, group, "{}{}".format(*phase)))
    # Of the four the axes have one extent.
    return Phases(tuple(pieces), ctx.node.input[0], _extent(window) or Extent.BEYOND, clean=False)


def _shifts(size: int, pad: int, phases: tuple[int, ...]) -> range:
    """Along one axis: the shifts s at which the phases read taps, with 0 among them."""
    reads = [s for s in range(-size, size + 1) for a in phases if 0 <= a + pad - 2 * s < size]
    return range(min(0, *reads), max(0, *reads) + 1)


def _kernel(weight: Array, begin: tuple[int, ...], phase: tuple[int, int], shifts: list[range]) -> Array:
    """W[a + p - 2 s] at each of the shifts: (O, I, rows, columns)."""
    kernel = np.zeros((*weight.shape[:2], *map(len, shifts)), weight.dtype)
    for (row, sy), (column, sx) in itertools.product(*map(enumerate, shifts)):
        ty, tx = phase[0] + begin[0] - 2 * sy, phase[1] + begin[1] - 2 * sx
        if 0 <= ty < weight.shape[2] and 0 <= tx < weight.shape[3]:
            kernel[:, :, row, column] = weight[:, :, ty, tx]
    return kernel


def _piece(
    ctx: Context, grad_y: str, window: Window, kernel: Array, shifts: list[range], group: int, tag: str
) -> str:
    # h windows belong to x of 2 (h - 1) + k - p - q rows, or one more, which none reaches: so many j beyond h.
    pads = [-s[0] for s in shifts] + [over // 2 + s[-1] for over, s in zip(_overhang(window), shifts, strict=True)]
    weights = ctx.const(kernel, f"weight_{tag}")
    size = list(kernel.shape[2:])
    return ctx.op("Conv", grad_y, weights, role=f"dx_{tag}", kernel_shape=size, pads=pads, group=group)


def _overhang(window: Window) -> list[int]:
    """k - p - q along each axis."""
    assert window.begin is not None, "suits has seen to that"
    return [k - p - q for k, p, q in zip(window.kernel, window.begin, window.end, strict=True)]


def _extent(window: Window) -> Extent | None:
    """What the phases hold; None if that differs between rows and columns."""
    odd = {over % 2 for over in _overhang(window)}
    return None if len(odd) > 1 else Extent.CEIL if odd == {1} else Extent.BEYOND
