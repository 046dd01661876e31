"""Write convolutions and resizings in the forms that onnxruntime-web's WebGPU computes as ONNX defines them.

Of onnxruntime-web 1.30, by its source (lib/wasm/jsep/webgpu/ops) and by comparing all values with WebAssembly's:

- Conv: an attribute that is not stated is an error (``dilations should be 2D``).
- Conv with a kernel of 1x1, without strides and with no padding but at the ends is computed as a product of matrices,
  without the padding.  Dilations mean nothing to a kernel of 1x1, and with dilations of 2 it is a convolution again.
- Resize by scales: the size is rounded, where ONNX takes the floor; what is beyond has to be cut off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import onnx
from onnx import TensorProto, helper

from elf_export.graph.graph import Graph, attributes, nested_graphs


def portable_forms(graph: Graph) -> Graph:
    """State what Conv leaves to its defaults, and cut what Resize makes to the size that ONNX says.

    requires : opset 11 or later.
    call : last of all, on the model that is written; on one that has been through it, it changes nothing.
    ensures : the same values to the last bit.  In bodies of control flow convolutions state all, resizings stay; so do
        those whose result is quantised, since WebGPU has no kernels for 8 bits.
    """
    graphs = list(nested_graphs(graph.model.graph))
    shapes = {tensor.name: tuple(tensor.dims) for proto in graphs for tensor in proto.initializer}
    for proto in graphs:
        for node in proto.node:
            if node.op_type == "Conv":
                _state(node, shapes.get(node.input[1]) or graph.shape(node.input[1]))
    for node in list(graph.nodes):
        if node.op_type == "Resize" and _may_round(graph, node):
            _cut(graph, node)
    return graph


def _state(node: onnx.NodeProto, weights: Sequence[object] | None) -> None:
    given = attributes(node)
    if weights is None or given.get("auto_pad", "NOTSET") != "NOTSET":
        return
    kernel, axes = list(weights[2:]), len(weights) - 2
    defaults: Mapping[str, list[int]] = {"dilations": [1] * axes, "strides": [1] * axes, "pads": [0] * 2 * axes}
    stated = {name: list(given.get(name, default)) for name, default in defaults.items()}
    only_ends = any(stated["pads"]) and not any(stated["pads"][:axes])
    if kernel == [1] * axes and stated["strides"] == [1] * axes and only_ends:
        stated["dilations"] = [2] * axes
    for name, values in stated.items():
        if given.get(name) != values:
            kept = [attribute for attribute in node.attribute if attribute.name != name]
            del node.attribute[:]
            node.attribute.extend([*kept, helper.make_attribute(name, values)])


def _may_round(graph: Graph, node: onnx.NodeProto) -> bool:
    """Whether it goes by scales, which are not whole numbers, and is not cut yet."""
    if len(node.input) < 3 or not node.input[2] or any(node.input[3:]) or graph.rank(node.input[0]) is None:
        return False
    scales = graph.constant(node.input[2])
    if scales is not None and np.array_equal(scales, np.floor(scales)):
        return False
    readers = graph.consumers().get(node.output[0], ())
    return not any(reader.op_type == "QuantizeLinear" or _cuts_by(graph, reader, node.input[2]) for reader in readers)


def _cuts_by(graph: Graph, node: onnx.NodeProto, scales: str) -> bool:
    """Whether a node is the Slice of `_cut`: its ends are the floor of a product with the scales."""
    read = list(node.input[2:3]) if node.op_type == "Slice" else []
    for op in ("Cast", "Floor", "Mul"):
        maker = graph.producers().get(read[0]) if read else None
        read = list(maker.input) if maker is not None and maker.op_type == op else []
    return scales in read


def _cut(graph: Graph, node: onnx.NodeProto) -> None:
    """Keep floor(size * scale) rows and columns of what it makes; sizes times scales in float32, as in ONNX Runtime."""
    x, scales, given = node.input[0], node.input[2], attributes(node)
    name = node.name or node.output[0]
    with graph.replace_node(node):
        whole = graph.op("Resize", *node.input, name=f"{name}/whole", **given)
        axes = [graph.int64s(given["axes"], f"{name}/axes")] if "axes" in given else []
        sizes = graph.op("Shape", x, name=f"{name}/sizes")
        for chosen in axes:
            sizes = graph.op("Gather", sizes, chosen, name=f"{name}/sizes")
        sizes = graph.op("Cast", sizes, name=f"{name}/sizes", to=TensorProto.FLOAT)
        sizes = graph.op("Floor", graph.op("Mul", sizes, scales, name=f"{name}/sizes"), name=f"{name}/sizes")
        ends = graph.op("Cast", sizes, name=f"{name}/sizes", to=TensorProto.INT64)
        starts = graph.int64s([0] * len(given.get("axes") or graph.shape(x) or ()), f"{name}/starts")
        graph.op("Slice", whole, starts, ends, *axes, name=f"{name}/cut", outputs=[node.output[0]])
