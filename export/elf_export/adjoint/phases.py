"""Gradients held as their four phases, so that max-pooling's adjoint never interleaves a full-size map.

The adjoint of a 2x2 max-pool writes each gradient to one of four places: the phases (a, b) of a map v,

    v_ab[i, j] = v[2 i + a, 2 j + b]

are cheap to make, and putting them together is not: it moves every value, outside the blocked layout in which
ONNX Runtime convolves.  So a gradient may stay in phases while it passes through ReLUs and convolutions of
stride 1 (the same multiplications, sorted by phase), and is put together only where a rule wants it whole,
at the latest at the image, where it has three channels.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from elf_export.graph.graph import Array
from elf_export.graph.windows import window_of

from . import depthwise
from .clip import room
from .depthwise import FEW, every_second
from .gradient import PHASES, Extent, Part, Phases, Rectified
from .interleave import known_channels, whole
from .registry import Context, Rule
from .spatial import flipped


def relu(ctx: Context, grad: Phases) -> Phases | None:
    """dx = dy [y > 0], phase by phase."""
    y = ctx.node.output[0]
    if grad.zero_unless_positive == y:
        return Phases(grad.pieces, ctx.node.input[0], grad.extent, grad.clean)
    return _masked(ctx, grad, y)


def clip(ctx: Context, grad: Phases) -> Phases | None:
    """dx = dy [low < y < high], phase by phase."""
    inside = room(ctx)
    return None if inside is None else _masked(ctx, grad, inside)


def _masked(ctx: Context, grad: Phases, v: str) -> Phases | None:
    """dx = dy [v > 0], v being of the shape of the node's input."""
    if len(grad.pieces) == 1:
        return None
    pieces = []
    for (a, b), piece in zip(PHASES, grad.pieces, strict=True):
        (rows, above, below), (columns, left, right) = (every_second(c, grad.extent) for c in (a, b))
        pads, pick = (above, left, below, right), np.outer(rows, columns)
        mask = depthwise.step(ctx, v, pick, [2, 2], f"mask_{a}{b}", pads, dilations=[2, 2])
        pieces.append(ctx.op("Mul", piece, mask, role=f"dx_{a}{b}"))
    # Beyond v's edge the masks are zero, and with them the products.
    return Phases(tuple(pieces), ctx.node.input[0], grad.extent)


def conv(ctx: Context, grad: Phases) -> Phases | None:
    """dx = W^T * dy for stride 1 and output of the input's size, W^T being the flipped kernel V with padding q:

        dx[r] = sum over t of V[t] dy[r + t - q]      r = 2 i + a,   r + t - q = 2 (i + s) + c

    Every tap t of output phase a reads one input phase c at one shift s, so that each pair of phases is a
    small convolution with every second row and column of V.  Where dx has few channels, its four phases are
    computed by one convolution, side by side.
    """
    node = ctx.node
    weight = ctx.value(node.input[1])
    if weight is None or weight.ndim != 4 or not grad.clean or len(grad.pieces) == 1 or ctx.attrs.get("group", 1) > 1:
        return None
    window = window_of(ctx.graph, node, weight.shape[2:])
    if window.begin is None or window.strides != (1, 1) or window.dilations != (1, 1):
        return None
    same_size = all(b + e == k - 1 for b, e, k in zip(window.begin, window.end, window.kernel, strict=True))
    if not same_size:
        return None
    kernel = flipped(weight, 1)
    pads = [k - 1 - b for k, b in zip(window.kernel, window.begin, strict=True)]
    few = 4 * kernel.shape[0] <= FEW
    wanted = [PHASES] if few else [(phase,) for phase in PHASES]
    try:
        weights: dict[bytes, str] = {}
        pieces = [_phase_of_conv(ctx, grad, kernel, pads, outputs, weights) for outputs in wanted]
    except _BeyondReachError:
        return None
    extent = Extent.BEYOND if grad.extent is Extent.FLOOR else grad.extent
    return Phases(tuple(pieces), node.input[0], extent, clean=False)


class _BeyondReachError(Exception):
    """A tap so far to one side that a convolution would need negative padding."""


def _phase_of_conv(
    ctx: Context,
    grad: Phases,
    kernel: Array,
    pads: Sequence[int],
    outputs: Sequence[tuple[int, int]],
    weights: dict[bytes, str],
) -> str:
    """The phases `outputs` of dx, side by side along the channels; `weights` are the constants there are already."""
    plans = []
    for source, piece in zip(PHASES, grad.pieces, strict=True):
        taps = [_taps(kernel.shape[2 + axis], pads[axis], source[axis], [o[axis] for o in outputs]) for axis in (0, 1)]
        if not all(taps):
            continue
        low = [min(s for s, _, _ in t) for t in taps]
        high = [max(s for s, _, _ in t) for t in taps]
        size = [top - bottom + 1 for bottom, top in zip(low, high, strict=True)]
        part = np.zeros((len(outputs) * kernel.shape[0], kernel.shape[1], *size))
        for (sy, ay, ty), (sx, ax, tx) in itertools.product(*taps):
            if (ay, ax) in outputs:
                at = outputs.index((ay, ax)) * kernel.shape[0]
                part[at : at + kernel.shape[0], :, sy - low[0], sx - low[1]] = kernel[:, :, ty, tx]
        # Output row i reads rows i + low .. i + high.  What ends with the last window reaches one row further.
        edges = [-lo for lo in low] + [h + (grad.extent is Extent.FLOOR) for h in high]
        if min(edges) < 0:
            raise _BeyondReachError
        plans.append((piece, source, part, edges))
    tag = "".join(f"{a}{b}" for a, b in outputs) if len(outputs) == 1 else "all"
    total: str | None = None
    for piece, (c, d), part, edges in plans:
        part = part.astype(kernel.dtype)
        # The taps on even or odd rows and columns are the same for every phase of the output.
        key = part.tobytes()
        if key not in weights:
            weights[key] = ctx.const(part, f"weight_{tag}_from_{c}{d}")
        term = ctx.op(
            "Conv", piece, weights[key], role=f"dx_{tag}_from_{c}{d}", kernel_shape=list(part.shape[2:]), pads=edges
        )
        # A sum of two, the convolution first, is computed in place by it.
        total = term if total is None else ctx.op("Add", term, total, role=f"dx_{tag}_with_{c}{d}")
    if total is None:
        raise _BeyondReachError
    return total


def _taps(size: int, pad: int, source: int, outputs: Sequence[int]) -> list[tuple[int, int, int]]:
    """Along one axis: (shift, output phase, tap) of all taps that read phase `source`."""
    reads = [((a + t - pad) // 2, (a + t - pad) % 2, a, t) for a in sorted(set(outputs)) for t in range(size)]
    return [(shift, a, t) for shift, c, a, t in reads if c == source]


_ON_PHASES: dict[str, Callable[[Context, Phases], Phases | None]] = {"Relu": relu, "Clip": clip, "Conv": conv}


def _is_masked(grad: Part | None, y: str) -> bool:
    """Whether the gradient is zero wherever y = max(x, 0) is: made so, or y itself, the seed."""
    return isinstance(grad, str) and (grad == y or (isinstance(grad, Rectified) and grad.unless_positive == y))


def apply(rule: Rule, ctx: Context, grads: Sequence[Part | None]) -> list[Part | None]:
    """A node's rule; its form for phases where the gradient arrives in phases and there is one for this node."""
    (first, *others) = grads
    if ctx.node.op_type == "Relu" and _is_masked(first, ctx.node.output[0]):
        return [str(first)]
    # Phases of its input's gradient could be masked and put together: both need the channels.
    able = ctx.node.op_type in _ON_PHASES and known_channels(ctx.graph, ctx.node.input[0]) is not None
    if isinstance(first, Phases) and not others and able:
        passed = _ON_PHASES[ctx.node.op_type](ctx, first)
        if passed is not None:
            return [passed]
    return [*rule(ctx, ctx.node, *(None if g is None else whole(ctx.graph, g) for g in grads))]
