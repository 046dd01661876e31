"""The four phases of a gradient put together to one map.

In the blocked layout in which ONNX Runtime convolves, and in NCHW, interleaving moves single values.  Channels last it
moves whole pixels: joining two maps along the channels IS interleaving their columns, once the result is read as twice
as many pixels, and joining rows along the width is interleaving them.  ONNX Runtime changes from blocks to channels
last and back in one go.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elf_export.graph.graph import Graph, reduce_mean

from .gradient import ADJOINT, Extent, Part


def whole(graph: Graph, part: Part) -> str:
    """The gradient as one (N, C, H, W) value: phases interleaved and cut, or filled up with zeros, to `like`."""
    if isinstance(part, str):
        return part
    role = f"{ADJOINT}{part.like}"
    if len(part.pieces) == 1:
        full = graph.op("DepthToSpace", *part.pieces, name=f"{role}/interleaved", blocksize=part.step, mode="DCR")
        return fitted(graph, full, part.like, 2, part.extent, f"{role}/whole")
    full = interleaved(graph, part.pieces, channels_of(graph, part.like), role)
    return channels_first(graph, fitted(graph, full, part.like, 1, part.extent, f"{role}/whole_nhwc"), f"{role}/whole")


def mean_magnitude(graph: Graph, part: Part, axis: int, output: str) -> str:
    """abs(v) averaged over the channels, which are `axis` of v: (N, H, W), called `output`.

    Of phases that are side by side in one piece, one ConvTranspose adds up the channels and interleaves what is left.
    """
    if isinstance(part, str) or len(part.pieces) > 1:
        absolute = graph.op("Abs", whole(graph, part), name=f"{output}/abs")
        return reduce_mean(graph, absolute, axis, f"{output}/mean", keepdims=0, output=output)
    (piece,), size, channels = part.pieces, [part.step] * 2, channels_of(graph, part.like)
    absolute = graph.op("Abs", piece, name=f"{output}/abs")
    places = np.repeat(np.eye(part.step**2).reshape(-1, 1, *size), channels, axis=0)
    kernel = graph.const(places, f"{output}/places", graph.dtype(part.like))
    sums = graph.op("ConvTranspose", absolute, kernel, name=f"{output}/sums", kernel_shape=size, strides=size)
    mean = fitted(graph, sums, part.like, 2, part.extent, f"{output}/cut")
    if channels > 1:
        count = graph.const(channels, f"{output}/channels", graph.dtype(part.like))
        mean = graph.op("Div", mean, count, name=f"{output}/mean")
    as_input = graph.opset >= 13
    axes = [graph.int64s([1], f"{output}/axis")] if as_input else []
    attributes = {"axes": None if as_input else [1]}
    return graph.op("Squeeze", mean, *axes, name=f"{output}/map", outputs=[output], **attributes)


def interleaved(graph: Graph, pieces: Sequence[str], channels: int, role: str) -> str:
    """Phases 00, 01, 10, 11, (N, C, h, w) each, to one map channels last, (N, 2 h, 2 w, C)."""
    last = [
        channels_last(graph, piece, f"{role}/phase_{place}_nhwc")
        for piece, place in zip(pieces, ("00", "01", "10", "11"), strict=True)
    ]
    lines = columns(graph, last[:2], channels, f"{role}/even"), columns(graph, last[2:], channels, f"{role}/odd")
    return rows(graph, lines, channels, f"{role}/interleaved")


def columns(graph: Graph, pair: Sequence[str], channels: int, name: str) -> str:
    """Even and odd columns, (N, h, w, C) each, interleaved: (N, h, 2 w, C)."""
    beside = graph.op("Concat", *pair, name=f"{name}_pairs", axis=3)
    return graph.op("Reshape", beside, graph.int64s([0, 0, -1, channels], f"{name}_shape"), name=name)


def rows(graph: Graph, pair: Sequence[str], channels: int, name: str) -> str:
    """Even and odd rows, (N, h, w, C) each, interleaved: (N, 2 h, w, C)."""
    behind = graph.op("Concat", *pair, name=f"{name}_stacked", axis=2)
    width = slice_of_shape(graph, pair[0], 2, 3, f"{name}_width")
    sizes = [graph.int64s([0, -1], f"{name}_keep"), width, graph.int64s([channels], f"{name}_channels")]
    return graph.op("Reshape", behind, graph.op("Concat", *sizes, name=f"{name}_shape", axis=0), name=name)


def fitted(graph: Graph, full: str, like: str, axis: int, extent: Extent, name: str) -> str:
    """`full` cut, or filled up with zeros (extent FLOOR), to the H and W of `like`, (N, C, H, W).

    `axis` is where H and W begin in `full`: 2, or 1 channels last.
    """
    size = slice_of_shape(graph, like, 2, 4, f"{name}_size")
    if extent is not Extent.FLOOR:
        bounds = [graph.int64s(v, f"{name}_{what}") for v, what in (([0, 0], "from"), ([axis, axis + 1], "axes"))]
        return graph.op("Slice", full, bounds[0], size, bounds[1], name=name)
    # Rows and columns that no window covers are zero.
    have = slice_of_shape(graph, full, axis, axis + 2, f"{name}_full_size")
    before, after = (graph.int64s([0] * n, f"{name}_{what}") for n, what in ((4 + axis, "before"), (2 - axis, "after")))
    lack = graph.op("Sub", size, have, name=f"{name}_lack")
    pads = graph.op("Concat", before, lack, *([after] if axis == 1 else []), name=f"{name}_pads", axis=0)
    fill = graph.const(0, f"{name}_fill", graph.dtype(like))
    return graph.op("Pad", full, pads, fill, name=name, mode="constant")


def channels_of(graph: Graph, value: str) -> int:
    """C of a forward value (N, C, H, W) that is pooled, or on the way from there to the image."""
    channels = known_channels(graph, value)
    assert channels is not None, "checked by split_pool.splits and phases.apply"
    return channels


def known_channels(graph: Graph, value: str) -> int | None:
    """C of a value (N, C, H, W); None if it has another rank, or C is not known."""
    shape = graph.shape(value) or []
    return shape[1] if len(shape) == 4 and isinstance(shape[1], int) else None


def channels_last(graph: Graph, value: str, name: str) -> str:
    """(N, C, H, W) -> (N, H, W, C)."""
    return graph.op("Transpose", value, name=name, perm=[0, 2, 3, 1])


def channels_first(graph: Graph, value: str, name: str) -> str:
    """(N, H, W, C) -> (N, C, H, W)."""
    return graph.op("Transpose", value, name=name, perm=[0, 3, 1, 2])


def slice_of_shape(graph: Graph, value: str, start: int, stop: int, name: str) -> str:
    """int64 (stop - start,): sizes of a value along some of its axes."""
    shape = graph.op("Shape", value, name=f"{name}_shape")
    bounds = [graph.int64s([v], f"{name}_{what}") for v, what in ((start, "from"), (stop, "to"), (0, "axis"))]
    return graph.op("Slice", shape, *bounds, name=name)
