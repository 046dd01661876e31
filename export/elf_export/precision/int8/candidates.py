"""Which nodes of a float graph 8 bits suit, and what values have to be looked at before they are rounded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import onnx

from elf_export.dialect import is_own
from elf_export.graph.graph import GraphView, attributes
from elf_export.graph.response import sums_channels

# Ops that only move values, or choose among them: a result has the scheme of what it is made from.
MOVING = frozenset({
    "MaxPool", "Transpose", "Reshape", "Slice", "Pad", "DepthToSpace", "SpaceToDepth", "Concat", "Squeeze",
    "Unsqueeze", "Flatten", "Identity",
})  # fmt: skip
# Ops of rounded values whose result gets a scheme of its own.
COMBINING = frozenset({"Add", "Sum", "AveragePool", "Concat"})
CLAMPING = frozenset({"Relu", "Clip"})
INTENSITY = 10  # multiply-adds per value read or written; below that, rounding costs more than it saves

Readers = Mapping[str, Sequence[onnx.NodeProto]]


def candidates(graph: GraphView) -> list[str]:
    """The values that may need a scheme of their own: convolutions' inputs and results, and what combines such.

    None where no convolution gains from 8 bits.
    """
    if not any(is_convolution(graph, node) for node in graph.nodes):
        return []
    readers = graph.consumers()
    found: dict[str, None] = {}
    for node in graph.nodes:
        if is_convolution(graph, node) and not makes_step(readers, node):
            found[node.input[0]] = None
            after = only_reader(readers, node.output[0])
            clamped = after is not None and after.op_type in CLAMPING
            found[after.output[0] if after is not None and clamped else node.output[0]] = None
        elif node.op_type in COMBINING and graph.dtype(node.output[0]) == np.float32:
            found[node.output[0]] = None
    return [name for name in found if (graph.rank(name) or 0) == 4]


def is_convolution(graph: GraphView, node: onnx.NodeProto) -> bool:
    """A two-dimensional Conv in float32 with constant weights that 8 bits make faster."""
    if node.op_type != "Conv" or graph.dtype(node.input[0]) != np.float32:
        return False
    kernel = graph.constant(node.input[1])
    if kernel is None or kernel.ndim != 4 or not all(graph.is_constant(name) for name in node.input[2:] if name):
        return False
    group = attributes(node).get("group", 1)
    if sums_channels(kernel, group):
        return False  # squares, for example: what spans too many powers of two for 8 bits
    results, channels = kernel.shape[:2]
    intense = channels > 1 and kernel.size >= INTENSITY * (channels + results)
    return bool(intense or group > 1)


def makes_step(readers: Readers, node: onnx.NodeProto) -> bool:
    """Whether all that reads the node, a convolution without a bias, is one step."""
    after = only_reader(readers, node.output[0])
    return after is not None and len(node.input) == 2 and is_own(after, "Step")


def only_reader(readers: Readers, name: str) -> onnx.NodeProto | None:
    found = readers.get(name, [])
    return found[0] if len(found) == 1 else None
