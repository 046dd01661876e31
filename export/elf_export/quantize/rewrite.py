"""A float graph to one in 8-bit integers, as QuantizeLinear and DequantizeLinear pairs around its nodes.

Where a value is rounded as it is made, ALL its readers get the rounded one: the two sides of every comparison (a
max-pool's winner, a ReLU's sign) are the same numbers, and the graph differentiates the rounded network.  A value that
comes from floats is rounded for convolutions alone, for the same reason.

The steps [d > 0] that mask gradients, and products with them, cost nothing in precision: a convolution that
takes the difference d of two rounded values and is rounded itself, so coarsely that one level of difference
saturates, gives exactly zero or one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import onnx

from elf_export.graph import Graph, attributes
from elf_export.passes import cut

from .scheme import MASK, Scheme, reaching, weights

# Ops that only move values, or choose among them: a result has the scheme of what it is made from.
MOVING = frozenset({
    "MaxPool", "Transpose", "Reshape", "Slice", "Pad", "DepthToSpace", "SpaceToDepth", "Concat", "Squeeze",
    "Unsqueeze", "Flatten", "Identity",
})  # fmt: skip
# Ops of rounded values whose result gets a scheme of its own.
COMBINING = frozenset({"Add", "Sum", "AveragePool", "Concat"})
CLAMPING = frozenset({"Relu", "Clip"})
STEEP = 1e20  # a HardSigmoid from that slope on is a step
FINE = 16.0  # how much finer small gradients are kept than large ones
# What ONNX Runtime's 8-bit convolutions on x86 are fast for: channels of the input, and of the result, in such numbers.
DEPTH, BREADTH = 4, 16
WORTH = 10  # multiply-adds for each value that is read or written: with fewer, rounding costs more than is saved


def rewrite(model: onnx.ModelProto, schemes: Mapping[str, Scheme]) -> onnx.ModelProto:
    """A copy of `model` with its convolutions, and what lies between them, in 8-bit integers.

    Parameters
    ----------
    model : onnx.ModelProto
        In float32, opset 13 or later.
    schemes : mapping
        How to round the values of `candidates(model)`.
    """
    return _Rewriter(model, schemes).run()


def candidates(model: onnx.ModelProto) -> list[str]:
    """The values that may need a scheme of their own: convolutions' inputs and results, and what combines such.

    None where no convolution gains from 8 bits.
    """
    graph = Graph(model)
    if not any(_is_convolution(graph, node) for node in graph.nodes):
        return []
    readers = graph.consumers()
    found: dict[str, None] = {}
    for node in graph.nodes:
        if _is_convolution(graph, node) and not _makes_step(readers, node):
            found[node.input[0]] = None
            after = _only_reader(readers, node.output[0])
            clamped = after is not None and after.op_type in CLAMPING
            found[after.output[0] if after is not None and clamped else node.output[0]] = None
        elif node.op_type in COMBINING and graph.dtype(node.output[0]) == np.float32:
            found[node.output[0]] = None
    return [name for name in found if (graph.rank(name) or 0) == 4]


class _Rewriter:
    """Walks the nodes in order and appends what takes their place."""

    def __init__(self, model: onnx.ModelProto, schemes: Mapping[str, Scheme]) -> None:
        self.graph = Graph(model)
        self.schemes = schemes
        self.old = [onnx.NodeProto.FromString(node.SerializeToString()) for node in self.graph.nodes]
        self.readers = self.graph.consumers()
        self.makers = {name: node for node in self.old for name in node.output}
        self.outputs = {value.name for value in model.graph.output}
        self.integers: dict[str, str] = {}  # a value -> its integers
        self.twins: dict[str, str] = {}  # a value -> the rounded one that its readers get
        self.rounding: dict[str, Scheme] = {}  # and how it was rounded
        self.inside: set[str] = set()  # rounded for convolutions alone
        self.convolved: set[str] = set()  # made by 8-bit convolutions
        self.masks: set[str] = set()

    def run(self) -> onnx.ModelProto:
        nodes = self.graph.model.graph.node
        del nodes[:]
        for node in self.old:
            self._visit(node)
        del self.graph.model.graph.value_info[:]
        return cut(self.graph.model, [value.name for value in self.graph.model.graph.output])

    def _visit(self, node: onnx.NodeProto) -> None:
        if _is_convolution(self.graph, node):
            if not _makes_step(self.readers, node):
                self._convolution(node)
        elif node.op_type == "HardSigmoid" and self._is_step(node):
            self._step(node, self.makers[node.input[0]])
        elif (node.op_type == "Sign" or _is_steep(node)) and self._sign(node):
            pass
        elif not (node.op_type in MOVING and self._moved(node)):
            self._keep(node)
            self._round_result(node)

    def _moved(self, node: onnx.NodeProto) -> bool:
        """Move integers where the values are moved; False where they have none, or not one scheme."""
        data = list(node.input) if node.op_type == "Concat" else [node.input[0]]
        if not all(map(self._is_rounded, data)):
            return False
        if len({self.rounding[name] for name in data}) > 1 or len(node.output) > 1:
            return False
        scheme, result = self.rounding[data[0]], node.output[0]
        inputs = [self.integers.get(name, name) for name in node.input]
        if node.op_type == "Pad":
            fill = self.graph.constant(inputs[2]) if len(inputs) > 2 and inputs[2] else np.zeros(())
            if fill is None or np.any(fill):
                return False
            inputs[2:3] = [self.graph.const(np.uint8(scheme.zero), f"{result}/fill")]
        q = self.graph.op(node.op_type, *inputs, name=f"{result}/q", **attributes(node))
        self._dequantize(result, q, scheme)
        if result in self.outputs:
            self.graph.op("Identity", self.twins[result], name=f"{result}/out", outputs=[result])
        if data[0] in self.masks:
            self.masks.add(result)
        return True

    def _round_result(self, node: onnx.NodeProto) -> None:
        """Round what a node other than a convolution gives, where its inputs are rounded."""
        result = node.output[0]
        data = [name for name in node.input if name and not self.graph.is_constant(name)]
        known = [self.rounding[name] for name in data if self._is_rounded(name)]
        if node.op_type in CLAMPING:
            if result in self.schemes and (known or node.input[0] in self.convolved):
                self._round(result, self._up_to_bound(node, self.schemes[result]))
        elif not known or len(known) < len(data):
            return
        elif node.op_type == "Mul" and len(data) == 2 and self.masks.intersection(data):
            self._round(result, known[data[0] in self.masks])
        elif node.op_type in COMBINING and result in self.schemes:
            self._round(result, self.schemes[result])

    def _up_to_bound(self, node: onnx.NodeProto, scheme: Scheme) -> Scheme:
        """The scheme whose highest level is a Clip's upper bound, to the last bit: no gradient passes there."""
        bound = self.graph.constant(node.input[2]) if len(node.input) > 2 and node.input[2] else None
        if bound is None or scheme.zero or not 0.0 < float(bound) < np.inf:
            return scheme
        return reaching(float(bound))

    def _is_rounded(self, name: str) -> bool:
        """Whether all readers of the value get it rounded."""
        return name in self.rounding and name not in self.inside

    # -- convolutions ------------------------------------------------------------------------------------------

    def _convolution(self, node: onnx.NodeProto) -> None:
        x, y = node.input[0], node.output[0]
        if x not in self.rounding and x in self.schemes:
            # Others may compare it with what is not rounded, such as a max-pool's inputs with its result.
            self._round(x, self.schemes[x])
            self.inside.add(x)
        if x not in self.rounding:
            self._keep(node)
            return
        kernel = self.graph.constant(node.input[1])
        assert kernel is not None, "_is_convolution has seen to that"
        bias = self.graph.constant(node.input[2]) if len(node.input) > 2 and node.input[2] else None
        after = _only_reader(self.readers, y)
        if after is not None and after.op_type == "Abs" and bias is None and y in self.schemes:
            self._in_two_steps(node, kernel)
            return
        self._conv(node, x, kernel, bias, y)
        self.convolved.add(y)
        if x in self.masks:
            self._round(y, MASK)
            self.masks.add(y)
        elif y in self.schemes and not (after is not None and after.op_type in CLAMPING):
            self._round(y, self.schemes[y])

    def _conv(
        self, node: onnx.NodeProto, x: str, kernel: np.ndarray, bias: np.ndarray | None, output: str
    ) -> None:
        """The node with the rounded input, int8 weights and an int32 bias."""
        graph = self.graph
        q, scales = weights(kernel)
        source, given = self.twins[x], attributes(node)
        lack = -kernel.shape[1] % DEPTH
        if lack and given.get("group", 1) == 1:
            q = np.pad(q, [(0, 0), (0, lack), (0, 0), (0, 0)])
            source = self._deepened(x, lack)
        inputs = [source, self._constant(q, scales, f"{output}/weight")]
        if bias is not None:
            steps = scales * np.float32(self.rounding[x].scale)
            whole = np.clip(np.rint(bias / steps.astype(np.float64)), -(2**31) + 1, 2**31 - 1)
            inputs.append(self._constant(whole.astype(np.int32), steps, f"{output}/bias"))
        graph.op("Conv", *inputs, name=node.name or output, outputs=[output], **given)

    def _deepened(self, x: str, lack: int) -> str:
        """x with so many more channels, of zeros."""
        graph, scheme = self.graph, self.rounding[x]
        pads = graph.int64s([0, 0, 0, 0, 0, lack, 0, 0], f"{x}/deep_pads")
        fill = graph.const(np.uint8(scheme.zero), f"{x}/deep_fill")
        q = graph.op("Pad", self.integers[x], pads, fill, name=f"{x}/deep_q")
        return graph.op("DequantizeLinear", q, *self._scale(f"{x}/deep", scheme), name=f"{x}/deep")

    def _constant(self, q: np.ndarray, scales: np.ndarray, name: str) -> str:
        """Weights or biases, one scale for each output channel."""
        graph = self.graph
        zeros = graph.const(np.zeros(len(scales), q.dtype), f"{name}_zero")
        constants = graph.const(q, f"{name}_q"), graph.const(scales, f"{name}_scale"), zeros
        return graph.op("DequantizeLinear", *constants, name=name, axis=0)

    def _in_two_steps(self, node: onnx.NodeProto, kernel: np.ndarray) -> None:
        """|W x| in steps that are finer where it is small: |F W x| / F up to where that saturates."""
        graph, y = self.graph, node.output[0]
        count, scheme = len(kernel), self.schemes[y]
        idle = np.zeros((-2 * count % BREADTH, *kernel.shape[1:]))
        both = graph.unique(f"{y}/both")
        self._conv(node, node.input[0], np.concatenate([kernel, kernel * FINE, idle]), None, both)
        self._round(both, scheme)
        axis, halves = graph.int64s([1], f"{y}/axis"), []
        for start, name in ((0, "coarse"), (count, "fine")):
            bounds = [graph.int64s([v], f"{y}/{name}_{what}") for v, what in ((start, "from"), (start + count, "to"))]
            q = graph.op("Slice", self.integers[both], *bounds, axis, name=f"{y}/{name}_q")
            value = graph.op("DequantizeLinear", q, *self._scale(f"{y}/{name}", scheme), name=f"{y}/{name}")
            halves.append(graph.op("Abs", value, name=f"{y}/{name}_magnitude"))
        # -128 and 127 both saturate.
        top = graph.const(np.float32(126.5 * scheme.scale), f"{y}/top")
        inside = graph.op("Less", halves[1], top, name=f"{y}/fits")
        fine = graph.op("Mul", halves[1], graph.const(np.float32(1 / FINE), f"{y}/unit"), name=f"{y}/fine_scaled")
        self.twins[y] = graph.op("Where", inside, fine, halves[0], name=f"{y}/magnitude")

    # -- steps -------------------------------------------------------------------------------------------------

    def _is_step(self, node: onnx.NodeProto) -> bool:
        """Whether the HardSigmoid makes a mask of a difference of its own."""
        maker = self.makers.get(node.input[0])
        return maker is not None and _is_convolution(self.graph, maker) and _makes_step(self.readers, maker)

    def _step(self, node: onnx.NodeProto, difference: onnx.NodeProto) -> None:
        """[d > 0], d the difference of two rounded values; in floats where they are not."""
        x = difference.input[0]
        kernel = self.graph.constant(difference.input[1])
        if not self._is_rounded(x) or kernel is None:
            self._keep(difference)
            self._keep(node)
            return
        # One level of difference becomes 1, which is the largest number that the result's scheme has.
        self._conv(difference, x, kernel / self.rounding[x].scale, None, node.output[0])
        self._round(node.output[0], MASK)
        self.masks.add(node.output[0])

    def _sign(self, node: onnx.NodeProto) -> bool:
        """[x > 0] of values that are never negative, as a step; False where it is none."""
        x, shape = node.input[0], self.graph.shape(node.input[0]) or []
        scheme = self.rounding.get(x)
        if scheme is None or not self._is_rounded(x) or scheme.zero or len(shape) != 4 or not isinstance(shape[1], int):
            return False
        kernel = np.ones((shape[1], 1, 1, 1))
        difference = onnx.helper.make_node(
            "Conv", [x], [node.output[0]], name=node.name, group=shape[1], kernel_shape=[1, 1]
        )
        self._conv(difference, x, kernel / scheme.scale, None, node.output[0])
        self._round(node.output[0], MASK)
        self.masks.add(node.output[0])
        return True

    # -- nodes -------------------------------------------------------------------------------------------------

    def _keep(self, node: onnx.NodeProto) -> None:
        copy = self.graph.model.graph.node.add()
        copy.CopyFrom(node)
        # A shape is read off the integers: a value that nobody else reads as floats is never one.
        known = self.integers if node.op_type == "Shape" else self.twins
        for i, name in enumerate(node.input):
            copy.input[i] = name if name in self.inside else known.get(name, name)

    def _round(self, name: str, scheme: Scheme) -> None:
        if name in self.outputs:
            return
        q = self.graph.op("QuantizeLinear", name, *self._scale(name, scheme), name=f"{name}/q")
        self._dequantize(name, q, scheme)

    def _dequantize(self, name: str, q: str, scheme: Scheme) -> None:
        self.integers[name], self.rounding[name] = q, scheme
        self.twins[name] = self.graph.op("DequantizeLinear", q, *self._scale(name, scheme), name=f"{name}/rounded")

    def _scale(self, name: str, scheme: Scheme) -> tuple[str, str]:
        scale = self.graph.const(np.float32(scheme.scale), f"{name}/scale")
        return scale, self.graph.const(np.uint8(scheme.zero), f"{name}/zero")


def _is_convolution(graph: Graph, node: onnx.NodeProto) -> bool:
    """A two-dimensional Conv in float32 with constant weights that 8 bits make faster."""
    if node.op_type != "Conv" or graph.dtype(node.input[0]) != np.float32:
        return False
    kernel = graph.constant(node.input[1])
    if kernel is None or kernel.ndim != 4 or not all(graph.is_constant(name) for name in node.input[2:] if name):
        return False
    results, channels = kernel.shape[:2]
    worth = channels > 1 and kernel.size >= WORTH * (channels + results)
    return bool(worth or attributes(node).get("group", 1) > 1)


def _makes_step(readers: Mapping[str, list[onnx.NodeProto]], node: onnx.NodeProto) -> bool:
    """Whether all that reads the node is one HardSigmoid so steep that it is a step at zero."""
    after = _only_reader(readers, node.output[0])
    return after is not None and len(node.input) == 2 and _is_steep(after)


def _is_steep(node: onnx.NodeProto) -> bool:
    """A HardSigmoid so steep that it is a step at zero."""
    given = attributes(node)
    steep = given.get("alpha", 0.2) >= STEEP and -1.0 <= given.get("beta", 0.5) <= 0.0
    return bool(node.op_type == "HardSigmoid" and steep)


def _only_reader(readers: Mapping[str, list[onnx.NodeProto]], name: str) -> onnx.NodeProto | None:
    found = readers.get(name, [])
    return found[0] if len(found) == 1 else None
