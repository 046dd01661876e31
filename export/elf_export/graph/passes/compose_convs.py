"""Two convolutions in a row are one: exact inside, computed as before along the border."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import onnx
from onnx import helper

from elf_export.graph.graph import Array, Dim, Graph, GraphView, attributes

FAR = np.iinfo(np.int64).max


def compose_convs(graph: Graph, keep: Collection[str] = (), smallest: GraphView | None = None) -> Graph:
    """y = V * (W * x + b) + c = (V o W) * x + (sum V b + c), with the kernel (V o W) of k_V + k_W - 1 pixels.

    That is the saliency of a linear first layer, W^T (W x + b): SuperPoint's conv1a goes through 64 channels
    to give one, composed it is a single 5x5 kernel.

    With zero padding it holds only where the composed window lies inside the image.  A window that reaches
    over the border would also count values of W * x + b out there, which the second convolution takes for
    zero.  The rows and columns within reach of the border are therefore computed from strips of x by the two
    convolutions themselves, and put around the inside: exact everywhere, and cheap, a strip being k - 1
    pixels.

    requires : `smallest`, if given, is the graph with the sizes of the smallest image that it will run on.  The inside
        is a convolution without padding, which takes no map that is smaller than its kernel: then only where the map is
        known to be as large even there.
    call : behind the adjoint; `keep` are values that are asked for.
    ensures : the same values to rounding.  Composed is where both strides, dilations and groups are 1, the two together
        keep the image's size, nothing else reads the middle value, it is not in `keep`, and the composed kernel takes
        less arithmetic.
    """
    for second in [node for node in graph.nodes if node.op_type == "Conv"]:
        first = graph.producers().get(second.input[0])
        if first is None or first.op_type != "Conv":
            continue
        middle = first.output[0]
        if middle in graph.outputs or middle in keep or len(graph.consumers()[middle]) > 1:
            continue
        pair = _pair(graph, first, second)
        if pair is not None and (smallest is None or _holds(smallest.shape(first.input[0]), pair)):
            _replace(graph, first, second, pair)
    graph.prune()
    return graph


def _holds(shape: list[Dim] | None, pair: Pair) -> bool:
    """Whether a map of that shape, (N, C, H, W), has a place for the composed kernel."""
    sizes = zip((shape or [None] * 4)[2:], pair.kernel.shape[2:], strict=True)
    return all(isinstance(size, int) and size >= k for size, k in sizes)


@dataclass(frozen=True)
class Pair:
    """The composed kernel (O, I, kh, kw), its bias (O,), and its padding in front of and behind each axis."""

    kernel: Array
    bias: Array
    begin: tuple[int, int]
    end: tuple[int, int]


def _pair(graph: Graph, first: onnx.NodeProto, second: onnx.NodeProto) -> Pair | None:
    w, v = (graph.constant(node.input[1]) for node in (first, second))
    if w is None or v is None or w.ndim != 4 or v.ndim != 4 or not (_plain(first) and _plain(second)):
        return None
    b, c = (_bias(graph, node, len(kernel)) for node, kernel in ((first, w), (second, v)))
    if b is None or c is None:
        return None
    kernel = compose(w, v)
    pads = [sum(p) for p in zip(*(attributes(n).get("pads", [0] * 4) for n in (first, second)), strict=True)]
    begin, end = (pads[0], pads[1]), (pads[2], pads[3])
    keeps_size = all(p + q == k - 1 for p, q, k in zip(begin, end, kernel.shape[2:], strict=True))
    if not keeps_size or kernel.size >= w.size + v.size:
        return None
    return Pair(kernel.astype(w.dtype), (v.astype(np.float64).sum((2, 3)) @ b + c).astype(w.dtype), begin, end)


def compose(w: Array, v: Array) -> Array:
    """The kernel of v * (w * .), in float64: K[o, i, r] = sum over m and s of v[o, m, s] w[m, i, r - s]."""
    (outputs, _, vh, vw), (_, inputs, wh, ww) = v.shape, w.shape
    kernel = np.zeros((outputs, inputs, vh + wh - 1, vw + ww - 1))
    for y in range(vh):
        for x in range(vw):
            kernel[:, :, y : y + wh, x : x + ww] += np.einsum(
                "om,mihw->oihw", v[:, :, y, x].astype(np.float64), w.astype(np.float64)
            )
    return kernel


def _plain(node: onnx.NodeProto) -> bool:
    a = attributes(node)
    ones = all(d == 1 for key in ("strides", "dilations") for d in a.get(key, ()))
    return ones and a.get("group", 1) == 1 and a.get("auto_pad", "NOTSET") == "NOTSET"


def _bias(graph: Graph, node: onnx.NodeProto, channels: int) -> Array | None:
    if len(node.input) < 3 or not node.input[2]:
        return np.zeros(channels)
    value = graph.constant(node.input[2])
    return None if value is None else value.astype(np.float64)


def _replace(graph: Graph, first: onnx.NodeProto, second: onnx.NodeProto, pair: Pair) -> None:
    """Put  top / (left | inside | right) / bottom  in the place of the two nodes."""
    with graph.replace_node(second):
        _append(graph, first, second, pair)
    graph.remove(first)


def _append(graph: Graph, first: onnx.NodeProto, second: onnx.NodeProto, pair: Pair) -> None:
    x, result, tag = first.input[0], second.output[0], f"{second.name or second.output[0]}/composed"

    def strip(name: str, axis: int, size: int, front: bool) -> str:
        """The first or last `size` rows (axis 2) or columns (axis 3) of the result."""
        reach = pair.kernel.shape[axis] - 1
        start, stop = (0, reach) if front else (-reach, FAR)
        source = _slice(graph, x, axis, start, stop, f"{tag}/{name}_source")
        for role, node in (("1", first), ("2", second)):
            given = {a.name: helper.get_attribute_value(a) for a in node.attribute}
            source = graph.op("Conv", source, *node.input[1:], name=f"{tag}/{name}_conv{role}", **given)
        start, stop = (0, size) if front else (-size, FAR)
        return _slice(graph, source, axis, start, stop, f"{tag}/{name}")

    y = graph.op(
        "Conv", x, graph.const(pair.kernel, f"{tag}/kernel"), graph.const(pair.bias, f"{tag}/bias"),
        name=f"{tag}/inside", kernel_shape=list(pair.kernel.shape[2:]),
    )  # fmt: skip
    top, left = pair.begin
    bottom, right = pair.end
    for axis, names, before, after in (
        (3, ("left", "right"), left, right),
        (2, ("top", "bottom"), top, bottom),
    ):
        parts = [y]
        for name, size, front in ((names[0], before, True), (names[1], after, False)):
            if size:
                edge = strip(name, axis, size, front)
                if axis == 3:  # the corners belong to top and bottom
                    edge = _slice(graph, edge, 2, top, -bottom or FAR, name=f"{tag}/{name}_inner")
                parts.insert(0 if front else len(parts), edge)
        last = [result] if axis == 2 else 1
        y = graph.op("Concat", *parts, name=f"{tag}/{'rows' if axis == 2 else 'columns'}", outputs=last, axis=axis)


def _slice(graph: Graph, x: str, axis: int, start: int, stop: int, name: str) -> str:
    bounds = {"from": start, "to": stop, "axis": axis}
    inputs = [graph.int64s([value], f"{name}_{role}") for role, value in bounds.items()]
    return graph.op("Slice", x, *inputs, name=name)
