"""Which nodes of a float graph 8 bits suit, and what values have to be looked at before they are rounded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import onnx

from elf_export.adjoint.emit import STEEP
from elf_export.adjoint.gradient import ADJOINT
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
        elif is_spreading(graph, readers, node):
            found.update(dict.fromkeys([node.input[0], node.output[0]]))
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


def is_spreading(graph: GraphView, readers: Readers, node: onnx.NodeProto) -> bool:
    """A strided convolution's adjoint that can be written as convolutions: a ConvTranspose read by its Slice alone."""
    if node.op_type != "ConvTranspose" or len(node.input) > 2 or graph.dtype(node.input[0]) != np.float32:
        return False
    kernel, given = graph.constant(node.input[1]), attributes(node)
    if kernel is None or kernel.ndim != 4 or {"auto_pad", "output_shape"} & given.keys():
        return False
    group, strides, pads = given.get("group", 1), given.get("strides", [1, 1]), given.get("pads", [0] * 4)
    if (group > 1 and kernel.shape[:2] != (group, 1)) or set(given.get("dilations", [1])) != {1}:
        return False
    fits = all(p < k for p, k in zip(pads, kernel.shape[2:], strict=False)) and not any(pads[2:])
    return bool(fits and strides[0] == strides[1] > 1 and _is_cropped(graph, readers, node))


def _is_cropped(graph: GraphView, readers: Readers, node: onnx.NodeProto) -> bool:
    """Whether all that is read of the node's result is a part from its first row and column on.

    The convolutions make more of both behind its last ones: no end may count from there, nor lie beyond.  Of computed
    ends that is known of the adjoint's alone.
    """
    after = only_reader(readers, node.output[0])
    if after is None or after.op_type != "Slice" or len(after.input) < 4:
        return False
    starts, ends, axes = (graph.constant(name) for name in after.input[1:4])
    if starts is None or axes is None or starts.any() or not {2, 3} <= {int(axis) % 4 for axis in axes}:
        return False
    if ends is None:
        return node.name.startswith(ADJOINT)
    sizes = graph.shape(node.output[0]) or [None] * 4
    limits = [sizes[axis] for axis in axes]
    return all(isinstance(n, int) and 0 <= end <= n for n, end in zip(limits, ends, strict=True))


def makes_step(readers: Readers, node: onnx.NodeProto) -> bool:
    """Whether all that reads the node is one HardSigmoid so steep that it is a step at zero."""
    after = only_reader(readers, node.output[0])
    return after is not None and len(node.input) == 2 and is_steep(after)


def is_steep(node: onnx.NodeProto) -> bool:
    """A HardSigmoid so steep that it is a step at zero."""
    given = attributes(node)
    steep = given.get("alpha", 0.2) >= STEEP and -1.0 <= given.get("beta", 0.5) <= 0.0
    return bool(node.op_type == "HardSigmoid" and steep)


def only_reader(readers: Readers, name: str) -> onnx.NodeProto | None:
    found = readers.get(name, [])
    return found[0] if len(found) == 1 else None
