"""The adjoint of a convolution every d pixels: a convolution for each phase of its input's gradient.

    y[i] = sum over t of W[t] x[d i + t - p],   dx[d j + a] = sum over s of W[a + p - d s]^T dy[j + s]

A ConvTranspose is that too; ONNX Runtime's multiplies out all windows first and adds them up then, outside the blocked
layout in which it convolves.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np

from elf_export.adjoint.depthwise import FEW
from elf_export.adjoint.gradient import PHASES, Extent, Phases
from elf_export.adjoint.interleave import known_channels
from elf_export.adjoint.registry import Context
from elf_export.graph.graph import Array
from elf_export.graph.windows import Window

FARTHEST = 4  # pixels from one window to the next; putting more phases together takes longer


def suits(ctx: Context, window: Window, weight: Array | None, group: int) -> bool:
    """Whether `conv` can do this Conv, and faster than a ConvTranspose: to an image's few channels, or depthwise."""
    channels = known_channels(ctx.graph, ctx.node.input[0])
    if ctx.channels_last or weight is None or window.begin is None or channels is None:
        return False
    plain = window.dilations == (1, 1) and all(
        begin < k and begin + end <= k for k, begin, end in zip(window.kernel, window.begin, window.end, strict=True)
    )
    if group == 1:
        square = len(set(window.strides)) == 1 and 2 <= window.strides[0] <= FARTHEST
        return plain and square and 4 * channels <= FEW and _waste(window) <= 2
    # Every phase has a tap.
    alike = window.strides == (2, 2) and min(window.kernel) > 1 and _extent(window) is not None
    return plain and alike and group == channels == weight.shape[0]


def _waste(window: Window) -> float:
    """Multiplications by the one kernel of all phases, for each that the layer has."""
    taps = math.prod(window.strides) * math.prod(map(len, _all_shifts(window)))
    return taps / math.prod(window.kernel)


def conv(ctx: Context, grad_y: str, window: Window, weight: Array, group: int) -> Phases:
    """dx in phases, side by side in one piece that one convolution makes; of a depthwise one in four.

    weight: (O, I, k, k)
    """
    assert window.begin is not None, "checked by suits"
    step = window.strides[0]
    if group == 1:
        # (d^2 I, O, rows, columns): one kernel for all phases.
        shifts = _all_shifts(window)
        phases = itertools.product(range(step), repeat=2)
        kernel = np.concatenate([_kernel(weight, window, phase, shifts).swapaxes(0, 1) for phase in phases])
        pieces = [_piece(ctx, grad_y, window, kernel, shifts, 1, "all")]
    else:
        pieces = []
        for phase in PHASES:
            places = zip(window.kernel, window.begin, window.strides, phase, strict=True)
            shifts = [_shifts(k, p, d, [a]) for k, p, d, a in places]
            kernel = _kernel(weight, window, phase, shifts)
            pieces.append(_piece(ctx, grad_y, window, kernel, shifts, group, "{}{}".format(*phase)))
    # Of the four the axes have one extent.
    return Phases(tuple(pieces), ctx.node.input[0], _extent(window) or Extent.BEYOND, clean=False, step=step)


def _all_shifts(window: Window) -> list[range]:
    """Along each axis: the shifts at which any phase reads taps."""
    assert window.begin is not None, "checked by suits"
    places = zip(window.kernel, window.begin, window.strides, strict=True)
    return [_shifts(k, p, d, range(d)) for k, p, d in places]


def _shifts(size: int, pad: int, step: int, phases: Iterable[int]) -> range:
    """Along one axis: the shifts s at which the phases read taps, with 0 among them."""
    reads = [s for a in phases for s in range(-size, size + 1) if 0 <= a + pad - step * s < size]
    return range(min(0, *reads), max(0, *reads) + 1)


def _kernel(weight: Array, window: Window, phase: tuple[int, ...], shifts: list[range]) -> Array:
    """W[a + p - d s] at each of the shifts: (O, I, rows, columns)."""
    assert window.begin is not None, "checked by suits"
    kernel = np.zeros((*weight.shape[:2], *map(len, shifts)), weight.dtype)
    for (row, sy), (column, sx) in itertools.product(*map(enumerate, shifts)):
        ty, tx = (a + p - d * s for a, p, d, s in zip(phase, window.begin, window.strides, (sy, sx), strict=True))
        if 0 <= ty < weight.shape[2] and 0 <= tx < weight.shape[3]:
            kernel[:, :, row, column] = weight[:, :, ty, tx]
    return kernel


def _piece(ctx: Context, grad_y: str, window: Window, kernel: Array, shifts: list[range], group: int, tag: str) -> str:
    # h windows belong to x of d (h - 1) + k - p - q rows, or up to d - 1 more, which none reaches: so many j beyond h.
    beyond = [-((1 - over) // d) for over, d in zip(_overhang(window), window.strides, strict=True)]
    pads = [-s[0] for s in shifts] + [more + s[-1] for more, s in zip(beyond, shifts, strict=True)]
    weights = ctx.const(kernel, f"weight_{tag}")
    size = list(kernel.shape[2:])
    return ctx.op("Conv", grad_y, weights, role=f"dx_{tag}", kernel_shape=size, pads=pads, group=group)


def _overhang(window: Window) -> list[int]:
    """k - p - q along each axis."""
    assert window.begin is not None, "checked by suits"
    return [k - p - q for k, p, q in zip(window.kernel, window.begin, window.end, strict=True)]


def _extent(window: Window) -> Extent | None:
    """What the phases of a convolution every 2 pixels hold; None if that differs between rows and columns."""
    odd = {over % 2 for over in _overhang(window)}
    return None if len(odd) > 1 else Extent.CEIL if odd == {1} else Extent.BEYOND
