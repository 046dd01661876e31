"""Float16 graphs, and float32 graphs whose weights are stored in bfloat16."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from elf_export.adjoint.emit import STEEP
from elf_export.graph.graph import Graph, attributes
from elf_export.graph.passes.cut import cut

PREPROCESSING = "pre/"
FLOAT32_INPUTS = frozenset({("Resize", 1), ("Resize", 2), ("Upsample", 1)})  # whatever the others are
MANY = 64  # smaller constants are not worth a Cast


def half_precision(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of `model` that computes in float16 between a float32 input and float32 outputs.

    The preprocessing stays in float32: the mean of a large image needs it.  Steps [d > 0] become Relu(Sign(d)), as a
    float16 has no slope of 1e30.
    """
    graph = Graph(model)
    proto = graph.model.graph
    old = [onnx.NodeProto.FromString(node.SerializeToString()) for node in graph.nodes]
    del proto.node[:]
    renamed: dict[str, str] = {}  # what float16 nodes read in a float32 value's place
    outside = {value.name for value in proto.input} | {
        name for node in old if node.name.startswith(PREPROCESSING) for name in node.output
    }
    outputs = {value.name for value in proto.output if graph.dtype(value.name) == np.float32}
    for node in old:
        if node.name.startswith(PREPROCESSING):
            proto.node.append(node)
            continue
        if node.op_type == "HardSigmoid" and attributes(node).get("alpha", 0.2) >= STEEP:
            sign = graph.op("Sign", renamed.get(node.input[0], node.input[0]), name=f"{node.output[0]}/sign")
            node = helper.make_node("Relu", [sign], list(node.output), name=node.name)
        for i, name in enumerate(node.input):
            if not name or graph.dtype(name) != np.float32 or (node.op_type, i) in FLOAT32_INPUTS:
                continue
            value = graph.constant(name)
            if name not in renamed and value is not None:
                renamed[name] = graph.const(_half(value), f"{name}/fp16")
            elif name not in renamed and name in outside:
                renamed[name] = graph.op("Cast", name, name=f"{name}/fp16", to=TensorProto.FLOAT16)
            node.input[i] = renamed.get(name, name)
        for attribute in node.attribute:
            if attribute.name in ("to", "dtype") and attribute.i == TensorProto.FLOAT:
                attribute.i = TensorProto.FLOAT16
            # A Constant's readers have a float16 copy of it, those of FLOAT32_INPUTS the Constant itself.
            if attribute.t.data_type == TensorProto.FLOAT and node.op_type != "Constant":
                half = _half(numpy_helper.to_array(attribute.t))
                attribute.t.CopyFrom(numpy_helper.from_array(half, attribute.t.name))
        for i, name in enumerate(node.output):
            if name in outputs:
                node.output[i] = renamed[name] = graph.unique(f"{name}/fp16")
        proto.node.append(node)
    for name in outputs:
        graph.op("Cast", renamed[name], name=f"{name}/fp32", outputs=[name], to=TensorProto.FLOAT)
    del proto.value_info[:]
    return cut(graph.model, [value.name for value in proto.output])


def _half(values: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):  # infinite then, as is the saliency, which is looked at
        return values.astype(np.float16)


def bfloat16_weights(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of `model` with its weights rounded to bfloat16, and cast to float32 where they are used.

    ONNX Runtime folds the casts when it loads the file: half the size on disk, and float32 arithmetic, except where a
    provider chooses bfloat16 itself.
    """
    result = onnx.ModelProto()
    result.CopyFrom(model)
    casts = []
    for tensor in result.graph.initializer:
        if tensor.data_type == TensorProto.FLOAT and np.prod(tensor.dims) >= MANY:
            stored = f"{tensor.name}/bf16"
            name, kind = f"{tensor.name}/cast", TensorProto.FLOAT
            casts.append(helper.make_node("Cast", [stored], [tensor.name], name=name, to=kind))
            tensor.CopyFrom(_bfloat16(numpy_helper.to_array(tensor), stored))
    nodes = [*casts, *(onnx.NodeProto.FromString(node.SerializeToString()) for node in result.graph.node)]
    del result.graph.node[:]
    result.graph.node.extend(nodes)
    return result


def _bfloat16(values: np.ndarray, name: str) -> TensorProto:
    """The upper halves of the float32 values, rounded to nearest, ties to even."""
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32).astype(np.uint64)
    rounded = ((bits + 0x7FFF + ((bits >> 16) & 1)) >> 16).astype(np.uint16)
    return helper.make_tensor(name, TensorProto.BFLOAT16, values.shape, rounded.tobytes(), raw=True)
