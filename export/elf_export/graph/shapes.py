"""Shape inference: ONNX's own, on a model without its weights, and what it leaves out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import onnx
from onnx import helper, shape_inference

from .nodes import OWN, Dim, copy_fields

Types = dict[str, onnx.TypeProto.Tensor]

MOST_STATED = 1024  # numbers of a tensor of floats that inference may look at, such as a Resize's scales
MADE_UP = "unk__"  # what inference calls the sizes that it can't tell
FLOATS = frozenset({onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT16, onnx.TensorProto.DOUBLE})


def infer(model: onnx.ModelProto, producers: Mapping[str, onnx.NodeProto], run: int = 0) -> Types:
    """The type of every tensor of the main graph but its constants; a value that nothing is known of is left out.

    Inference passes the whole model through C++ and back, so it gets the model without its weights: a convolution's
    result depends on the shape of its kernel, not on the numbers.

    Inference numbers the sizes that it can't tell from 0 on.  Of an edited graph it is run again, and a size that it
    numbers then must not be taken for one that had the number before: `run` tells the runs apart.
    """
    bare = without_weights(model)
    constants = {tensor.name: tensor for tensor in bare.graph.initializer}
    outputs = {value.name: value for value in bare.graph.output}
    types: Types = {}

    def shape(name: str) -> list[Dim] | None:
        return list(constants[name].dims) if name in constants else dims_of(types.get(name))

    def elem_type(name: str) -> int:
        kind = constants[name].data_type if name in constants else types[name].elem_type if name in types else 0
        return kind or onnx.TensorProto.FLOAT

    while True:
        inferred = shape_inference.infer_shapes(bare, data_prop=True).graph
        for value in (*inferred.value_info, *inferred.output, *inferred.input):
            if value.type.HasField("tensor_type"):
                types[value.name] = value.type.tensor_type
        news = False
        for node in bare.graph.node:
            name = node.output[0] if node.output else ""
            dims = _left_out(node, shape, producers) if name and shape(name) is None else None
            if dims is not None:
                value = outputs[name] if name in outputs else bare.graph.value_info.add()
                value.CopyFrom(helper.make_tensor_value_info(name, elem_type(node.input[0]), dims))
                types[name], news = value.type.tensor_type, True
        if not news:
            break
    for dim in (dim for kind in types.values() if run for dim in kind.shape.dim):
        if dim.dim_param.startswith(MADE_UP):
            dim.dim_param += f"_{run}"
    return types


def _left_out(
    node: onnx.NodeProto, shape: Callable[[str], list[Dim] | None], producers: Mapping[str, onnx.NodeProto]
) -> list[Dim] | None:
    """What can be told of the shape of a node's first output where ONNX's inference does not find it."""
    like = shape_source(node, producers)
    if like is not None and (dims := shape(like)) is not None:
        return dims
    if node.op_type not in ("Reshape", "Expand"):
        return None
    # The length of the target shape is the rank; Expand's result has at least the data's.
    length = (shape(node.input[1]) or [None])[0]
    own = shape(node.input[0]) if node.op_type == "Expand" else []
    return [None] * max(length, len(own)) if isinstance(length, int) and own is not None else None


def shape_source(node: onnx.NodeProto, producers: Mapping[str, onnx.NodeProto]) -> str | None:
    """A value whose shape the node's output has, where ONNX's inference would not tell."""
    if node.op_type == "GroupNormalization":
        return str(node.input[0])
    if node.op_type == "Reshape":
        target = producers.get(node.input[1])
        if target is not None and target.op_type == "Shape" and not target.attribute:
            return str(target.input[0])
    return None


def dims_of(kind: onnx.TypeProto.Tensor | None) -> list[Dim] | None:
    """Sizes: an int where static, a name where symbolic, None where unknown; None for an unknown rank."""
    if kind is None or not kind.HasField("shape"):
        return None
    return [
        d.dim_value if d.HasField("dim_value") else (d.dim_param or None if d.HasField("dim_param") else None)
        for d in kind.shape.dim
    ]


def without_weights(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of `model` in which large tensors of floats have a type and a shape, and no numbers."""
    bare = onnx.ModelProto()
    old, new = model.graph, bare.graph
    copy_fields(model, bare, without=["graph"])
    copy_fields(old, new, without=["initializer"])
    for node in new.node:
        if node.domain == OWN:  # which have the shape and the type of their last input
            node.CopyFrom(helper.make_node("Identity", [node.input[-1]], node.output, node.name))
    for tensor in old.initializer:
        if tensor.data_type in FLOATS and math.prod(tensor.dims) > MOST_STATED:
            new.initializer.add(name=tensor.name, data_type=tensor.data_type, dims=tensor.dims)
        else:
            new.initializer.append(tensor)
    return bare
