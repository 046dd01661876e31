"""Adjoints of pooling.

Both pools send each window's gradient back to places in that window.  `pieces` is that gradient split by the
place's offset in the window; `scatter` puts the pieces back side by side, overlapping windows added up.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import onnx

from elf_export.adjoint import depthwise
from elf_export.adjoint.emit import FAR, concat_ints, slice_axes, step
from elf_export.adjoint.gradient import PHASES, Phases
from elf_export.adjoint.interleave import whole
from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.adjoint.spatial import begin_pads, crop_spatial, pad_spatial, spatial_shape
from elf_export.graph.windows import Window, window_of

from . import interleaved, split_pool
from .shapes import rank_is_known

Offset = tuple[int, ...]


def _pool_supports(ctx: Context) -> str | None:
    if ctx.attrs.get("storage_order", 0):
        return "storage_order=1"
    return rank_is_known(ctx)


@adjoint("MaxPool", supports=_pool_supports)
def max_pool(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y_m = max over offsets o of x_{ms + od};  dx gets dy_m at the FIRST o in raster order that attains it.

    That is the choice of torch and of an index-based adjoint.  Ties above zero are common: flat regions of an
    image that was strongly JPEG-compressed give exactly equal values.  Without indices (MaxPool's second
    output and MaxUnpool are not portable, and wrong for overlapping windows) the gradient is handed from one
    offset to the next until somebody takes it:

        r_0 = dy;   taken_o = r_o * [x_o = y],   r_{o+1} = r_o - taken_o = r_o * [y - x_o > 0]

    The steps are exactly 0 or 1, so nothing is rounded.  The usual windows have forms of their own: 2x2 side by side
    `split_pool.split_max_pool` and `interleaved.max_pool`, overlapping 3x3 `interleaved.overlapping_max_pool`.
    """
    window = window_of(ctx.graph, node, ctx.attrs["kernel_shape"])
    if split_pool.splits(ctx, window):
        form = interleaved.max_pool if ctx.channels_last else split_pool.split_max_pool
        return [form(ctx, grad_y)]
    if interleaved.overlaps(ctx, window):
        return [interleaved.overlapping_max_pool(ctx, grad_y, window)]
    offsets = _offsets(window)
    y = node.output[0]
    views = _views(ctx, node.input[0], y, window, offsets)
    rest, pieces = grad_y, []
    for offset in offsets[:-1]:
        tag = _tag(offset)
        below = step(ctx, ctx.op("Sub", y, views[offset], role=f"gap{tag}"), f"below{tag}")
        passed = ctx.op("Mul", rest, below, role=f"passed{tag}")
        pieces.append(ctx.op("Sub", rest, passed, role=f"taken{tag}"))
        rest = passed
    pieces.append(rest)  # whoever is last takes what nobody took
    return [scatter(ctx, node.input[0], dict(zip(offsets, pieces, strict=True)), window)]


@adjoint("AveragePool", supports=rank_is_known)
def average_pool(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y_m = 1/c_m sum over offsets o of x_{ms + od};  dx_{ms + od} += dy_m / c_m.

    c_m is the window's number of pixels, without those in the padding unless count_include_pad.  2x2 side by side give
    four equal phases, put together at once where convolutions run channels last.
    """
    window = window_of(ctx.graph, node, ctx.attrs["kernel_shape"])
    if split_pool.splits(ctx, window):
        # A convolution, which 8 bits round, before all that moves its values.
        share = depthwise.convolve(ctx, grad_y, [[1 / math.prod(window.kernel)]], [1, 1], "share")
        phases = Phases((share,) * len(PHASES), node.input[0])
        return [whole(ctx.graph, phases) if ctx.channels_last else phases]
    if window.padded:
        share = ctx.op("Div", grad_y, _counts(ctx, node, window), role="share")
    else:
        inverse = ctx.const(1 / math.prod(window.kernel), "inverse", like=node.input[0])
        share = ctx.op("Mul", grad_y, inverse, role="share")
    return [scatter(ctx, node.input[0], dict.fromkeys(_offsets(window), share), window)]


def _counts(ctx: Context, node: onnx.NodeProto, window: Window) -> str:
    """(1, 1, out...): how many pixels each window averages over: a sum-pool of ones, zeros in the padding."""
    x, n = node.input[0], len(window.kernel)
    ones_shape = concat_ints(ctx, [[1, 1], spatial_shape(ctx, x, "ones_size")], "ones_shape")
    one = ctx.const(np.ones((1,) * (n + 2)), "one", like=x)
    ones = ctx.op("Expand", one, ones_shape, role="ones")
    begin = begin_pads(ctx, window, x)
    if ctx.attrs.get("count_include_pad", 0):
        # The stated padding counts; what ceil_mode adds behind it does not.
        ones = pad_spatial(ctx, ones, x, begin, window.end, "counted", fill=1)
        begin = ctx.int64s([0] * n, "counted_begin")
        spare = [s - 1 if window.ceil else 0 for s in window.strides]
    else:
        spare = [e + (s - 1 if window.ceil else 0) for e, s in zip(window.end, window.strides, strict=True)]
    ones = pad_spatial(ctx, ones, x, begin, spare, "framed")
    kernel = ctx.const(np.ones((1, 1, *window.kernel)), "count_kernel", like=x)
    counts = ctx.op(
        "Conv", ones, kernel, role="counts_full", kernel_shape=list(window.kernel),
        strides=list(window.strides), dilations=list(window.dilations),
    )  # fmt: skip
    size = spatial_shape(ctx, node.output[0], "counts_size")
    zero = ctx.int64s([0] * n, "counts_start")
    return crop_spatial(ctx, counts, zero, size, "counts", window.spatial_axes)


def _offsets(window: Window) -> list[Offset]:
    """Offsets of a window's places from its start, in pixels, in raster order."""
    ranges = (range(0, k * d, d) for k, d in zip(window.kernel, window.dilations, strict=True))
    return list(itertools.product(*ranges))


def _tag(offset: Offset) -> str:
    return "".join(f"_{o}" for o in offset)


def _views(ctx: Context, x: str, y: str, window: Window, offsets: Sequence[Offset]) -> dict[Offset, str]:
    """x_o[m] = padded x at m s + o, of y's size: one strided Slice per offset."""
    if window.padded:
        lowest = float(np.finfo(ctx.dtype(x)).min)
        extra = [e + (s - 1 if window.ceil else 0) for e, s in zip(window.end, window.strides, strict=True)]
        x = pad_spatial(ctx, x, x, begin_pads(ctx, window, x), extra, "padded", fill=lowest)
    steps = ctx.int64s(window.strides, "view_steps")
    span = ctx.op("Mul", spatial_shape(ctx, y, "y_size"), steps, role="span")
    axes = ctx.int64s(window.spatial_axes, "view_axes")
    views = {}
    for offset in offsets[:-1]:
        start = ctx.int64s(offset, f"view_start{_tag(offset)}")
        end = ctx.op("Add", span, start, role=f"view_end{_tag(offset)}")
        views[offset] = ctx.op("Slice", x, start, end, axes, steps, role=f"view{_tag(offset)}")
    return views


def scatter(ctx: Context, x: str, pieces: dict[Offset, str], window: Window) -> str:
    """dx of x's shape with dx[m s + o] = sum of pieces[o][m] over all (m, o) that meet there.

    An offset is q strides and a rest r.  All pieces with the same rest land on the same phase of dx, shifted
    by q; the phases are then interleaved, and what lies outside x is cut or what is missing is zero.
    """
    n, strides = len(window.kernel), window.strides
    most = tuple((e - 1) // s for e, s in zip(window.extent, strides, strict=True))
    by_phase: dict[Offset, list[str]] = {}
    for offset, piece in pieces.items():
        shift = tuple(o // s for o, s in zip(offset, strides, strict=True))
        phase = tuple(o % s for o, s in zip(offset, strides, strict=True))
        if any(most):
            after = [m - q for m, q in zip(most, shift, strict=True)]
            piece = pad_spatial(ctx, piece, x, shift, after, f"shifted{_tag(offset)}")
        by_phase.setdefault(phase, []).append(piece)
    phases = []
    for phase in itertools.product(*(range(s) for s in strides)):
        parts = by_phase.get(phase)
        if parts is None:  # a stride beyond the window leaves gaps
            some = next(iter(by_phase.values()))[0]
            zero = ctx.const(0, f"nothing{_tag(phase)}", like=x)
            parts = [ctx.op("Mul", some, zero, role=f"gap_phase{_tag(phase)}")]
        phases.append(parts[0] if len(parts) == 1 else ctx.op("Sum", *parts, role=f"phase{_tag(phase)}"))
    full = _interleave(ctx, phases, strides)

    dims = (ctx.shape(x) or [])[2:]
    size = spatial_shape(ctx, x, "x_size")
    if not window.padded and window.extent == strides:
        if all(isinstance(d, int) and d % s == 0 for d, s in zip(dims, strides, strict=True)):
            return full
        # Floor mode drops up to s - 1 trailing pixels; their gradient is zero.
        lack = ctx.op("Sub", size, spatial_shape(ctx, full, "full_size"), role="lack")
        return pad_spatial(ctx, full, x, [0] * n, lack, "dx")
    begin = begin_pads(ctx, window, x)
    if any(s > 1 for s in strides):
        full = pad_spatial(ctx, full, x, [0] * n, [s - 1 for s in strides], "room")
    return crop_spatial(ctx, full, begin, size, "dx", window.spatial_axes)


def _interleave(ctx: Context, phases: Sequence[str], strides: Sequence[int]) -> str:
    """(N, C, h...) per phase, in raster order -> (N, C, h s...)."""
    if len(phases) == 1:
        return phases[0]
    joined = ctx.op("Concat", *phases, role="phases", axis=1)
    n = len(strides)
    if n == 2 and strides[0] == strides[1]:
        return ctx.op("DepthToSpace", joined, role="interleaved", blocksize=strides[0], mode="DCR")
    # (N, s1..sn, C, h1..hn) -> (N, C, h1, s1, ..., hn, sn) -> (N, C, h1 s1, ..., hn sn)
    size = slice_axes(ctx, ctx.op("Shape", phases[0], role="phase_shape"), [2], [FAR], [0], "phase_size")
    apart = ctx.op("Reshape", joined, concat_ints(ctx, [[0, *strides, -1], size], "split_shape"), role="split")
    order = [0, n + 1, *itertools.chain.from_iterable((n + 2 + i, 1 + i) for i in range(n))]
    turned = ctx.op("Transpose", apart, role="turned", perm=order)
    merged = ctx.op("Mul", size, ctx.int64s(strides, "merge_strides"), role="merged_size")
    return ctx.op("Reshape", turned, concat_ints(ctx, [[0, 0], merged], "merge_shape"), role="interleaved")
