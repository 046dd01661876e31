"""A model in the words that onnxruntime-web's WebGPU understands; its values stay the same everywhere.

Found by comparing all values of the model in WebGPU and in WebAssembly, onnxruntime-web 1.30.0 (ort.min.mjs):

- Conv: an attribute that is not stated is an error (`dilations should be 2D`); defaults are written out.
- Conv with a kernel of 1x1, no strides and padding at the ends alone: the padding is ignored; a Pad goes behind it, the
  same without a bias (before it, ONNX Runtime would fuse the two again).
- Resize by `scales`: the size is rounded, where ONNX takes the floor; what is beyond is cut off.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import onnx
from onnx import NodeProto, TensorProto, helper, numpy_helper

_DEFAULTS = (("dilations", [1, 1]), ("strides", [1, 1]), ("pads", [0, 0, 0, 0]))


def for_webgpu(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of the model, opset 13 to 24, with the nodes of its main graph rewritten."""
    model = onnx.ModelProto.FromString(model.SerializeToString())
    graph = model.graph
    sizes = {constant.name: tuple(constant.dims) for constant in graph.initializer}
    nodes: list[NodeProto] = []
    for node in graph.node:
        if node.op_type == "Conv":
            nodes.extend(_conv(graph, node, sizes[node.input[1]][2:]))
        elif node.op_type == "Resize" and len(node.input) == 3:
            nodes.extend(_resize(graph, node))
        else:
            nodes.append(node)
    nodes = [NodeProto.FromString(node.SerializeToString()) for node in nodes]
    del graph.node[:]
    graph.node.extend(nodes)
    onnx.checker.check_model(model)
    return model


def _constant(graph: onnx.GraphProto, name: str, values: list[int]) -> str:
    graph.initializer.append(numpy_helper.from_array(np.array(values, np.int64), name))
    return name


def _conv(graph: onnx.GraphProto, node: NodeProto, kernel: tuple[int, ...]) -> Iterator[NodeProto]:
    stated = {attribute.name: attribute for attribute in node.attribute}
    for name, value in _DEFAULTS:
        if name not in stated and "auto_pad" not in stated:
            node.attribute.append(helper.make_attribute(name, value))
    pads = list(stated["pads"].ints) if "pads" in stated else [0, 0, 0, 0]
    strided = "strides" in stated and list(stated["strides"].ints) != [1, 1]
    if kernel != (1, 1) or strided or not any(pads):
        yield node
        return
    if len(node.input) > 2:
        raise ValueError(f"{node.name}: a padded convolution of 1x1 with a bias has no other form here")
    (whole,), name = node.output, f"{node.name}/inner"
    node.output[0] = name
    stated["pads"].ints[:] = [0, 0, 0, 0]
    yield node
    amounts = _constant(graph, f"{name}/amounts", [0, 0, *pads[:2], 0, 0, *pads[2:]])
    yield helper.make_node("Pad", [name, amounts], [whole], name=f"{node.name}/padded")


def _resize(graph: onnx.GraphProto, node: NodeProto) -> Iterator[NodeProto]:
    """floor(sizes * scales) rows and columns of what it makes."""
    x, _, scales = node.input
    name, whole = node.name, node.output[0]
    node.output[0] = f"{name}/whole"
    yield node
    steps = (
        ("Shape", [x], {}), ("Cast", [], {"to": TensorProto.FLOAT}), ("Mul", [scales], {}), ("Floor", [], {}),
        ("Cast", [], {"to": TensorProto.INT64}),
    )  # fmt: skip
    last: list[str] = []
    for i, (op, others, attributes) in enumerate(steps):
        made = f"{name}/size{i}"
        yield helper.make_node(op, last + others, [made], name=made, **attributes)
        last = [made]
    zeros = _constant(graph, f"{name}/zeros", [0, 0, 0, 0])
    yield helper.make_node("Slice", [f"{name}/whole", zeros, *last], [whole], name=f"{name}/cut")
