"""Proving that two sizes known at run time only are the same size.

ONNX's shape inference gives up a convolution's output size if the input's is symbolic.  Whether an operand
is broadcast can then not be read off the shapes: both branches of a residual sum are "unknown".  Here a size
is an expression in the sizes of the graph's inputs, and equal expressions are equal sizes.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import onnx

from elf_export.graph.graph import Dim, GraphView, attributes

_KEEP_SHAPE = frozenset({
    "Identity", "Dropout", "Cast", "Relu", "LeakyRelu", "PRelu", "Clip", "HardSigmoid", "HardSwish",
    "ThresholdedRelu", "Sigmoid", "Tanh", "Elu", "Selu", "Celu", "Softplus", "Softsign", "Mish", "Gelu",
    "Swish", "Erf", "Exp", "Log", "Abs", "Neg", "Sqrt", "Reciprocal", "Softmax", "LogSoftmax", "CumSum", "LRN",
    "BatchNormalization", "InstanceNormalization", "LayerNormalization", "GroupNormalization",
    "LpNormalization", "QuantizeLinear", "DequantizeLinear",
})  # fmt: skip
_ELEMENTWISE = frozenset({"Add", "Sub", "Mul", "Div", "Sum", "Max", "Min", "Mean"})
_WINDOWS = frozenset({"Conv", "MaxPool", "AveragePool"})


class Sizes:
    """Sizes of a graph's values as expressions; an expression is an int, a symbol or a tuple."""

    def __init__(self, graph: GraphView) -> None:
        self.graph = graph
        self.producers = graph.producers()
        self._known: dict[tuple[str, int], Hashable] = {}

    def of(self, name: str, axis: int) -> Hashable:
        """The size of value `name` along `axis` >= 0."""
        key = (name, axis)
        if key not in self._known:
            self._known[key] = key  # a cycle can't be, but an unknown size is only equal to itself
            self._known[key] = self._find(name, axis)
        return self._known[key]

    def _find(self, name: str, axis: int) -> Hashable:
        shape = self.graph.shape(name)
        node = self.producers.get(name)
        if shape is not None and isinstance(shape[axis], int):
            return shape[axis]
        # A derived size goes before a symbol: an output's symbols are whatever its author wrote there.
        unknown = (name, axis) if shape is None or shape[axis] is None else shape[axis]
        if node is None or shape is None or node.output[0] != name:
            return unknown
        source = self.graph.shape_source(node)
        if source is not None:
            return self.of(source, axis)
        if node.op_type in _KEEP_SHAPE:
            return self.of(node.input[0], axis)
        if node.op_type in _ELEMENTWISE:
            sizes = {self.of(n, axis - len(shape) + r) for n in node.input if (r := self._rank(n, len(shape) - axis))}
            sizes.discard(1)
            return sizes.pop() if len(sizes) == 1 else unknown
        if node.op_type in _WINDOWS and (axis >= 2 or axis == 0):
            size = self.of(node.input[0], axis)
            return size if axis == 0 else self._window(node, axis - 2, size, unknown)
        return unknown

    def _rank(self, name: str, at_least: int) -> int:
        """The rank of `name`, 0 if it does not reach that far to the left: it is repeated there."""
        rank = self.graph.rank(name)
        assert rank is not None, f"{name!r} has no rank although the result of its sum has"
        return rank if rank >= at_least else 0

    def _window(self, node: onnx.NodeProto, axis: int, size: Hashable, unknown: Hashable) -> Hashable:
        a = attributes(node)
        kernel: Sequence[Dim] = a.get("kernel_shape") or (self.graph.shape(node.input[1]) or [])[2:]
        n = len(kernel)
        places = kernel[axis] if axis < n else None
        if not isinstance(places, int):
            return unknown
        stride = a.get("strides", [1] * n)[axis]
        span = (places - 1) * a.get("dilations", [1] * n)[axis]
        auto = a.get("auto_pad", "NOTSET")
        if auto.startswith("SAME"):
            return size if stride == 1 else ("same", size, stride)
        pads = a.get("pads", [0] * 2 * n) if auto == "NOTSET" else [0] * 2 * n
        growth = pads[axis] + pads[axis + n] - span
        if stride == 1:
            return plus(size, growth)
        # Rounding up drops a window that starts behind the pixels: the padding in front counts too.
        up = pads[axis] if a.get("ceil_mode", 0) else None
        return ("steps", size, growth, stride, up)


def plus(size: Hashable, growth: int) -> Hashable:
    """size + growth, in a normal form."""
    if isinstance(size, int):
        return size + growth
    if isinstance(size, tuple) and size[0] == "plus":
        _, size, before = size
        growth += before
    return size if growth == 0 else ("plus", size, growth)
