"""Float16 graphs, and float32 graphs whose weights are stored in bfloat16."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from elf_export.graph.graph import Graph, GraphView
from elf_export.lowering import write_steps

PREPROCESSING = "pre/"
FLOAT32_INPUTS = frozenset({("Resize", 1), ("Resize", 2), ("Upsample", 1)})  # whatever the others are
MANY = 64  # smaller constants are not worth a Cast


def half_precision(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of `model` that computes in float16 between a float32 input and float32 outputs.

    The preprocessing stays in float32: the mean of a large image needs it.  Masks of `dialect` are written for float16.
    """
    written = write_steps(Graph(model), "fp16").model
    source, graph = GraphView(written), Graph(written)
    renamed: dict[str, str] = {}  # what float16 nodes read in a float32 value's place
    outside = set(source.inputs) | {
        name for node in source.nodes if node.name.startswith(PREPROCESSING) for name in node.output
    }
    outputs = [name for name in source.outputs if source.dtype(name) == np.float32]
    for node in list(graph.nodes):
        if node.name.startswith(PREPROCESSING):
            continue
        inputs = list(node.input)
        for i, name in enumerate(inputs):
            if not name or source.dtype(name) != np.float32 or (node.op_type, i) in FLOAT32_INPUTS:
                continue
            value = source.constant(name)
            if name not in renamed and value is not None:
                renamed[name] = graph.const(_half(value), f"{name}/fp16")
            elif name not in renamed and name in outside:
                with graph.insert_before(node):
                    renamed[name] = graph.op("Cast", name, name=f"{name}/fp16", to=TensorProto.FLOAT16)
            inputs[i] = renamed.get(name, name)
        for attribute in node.attribute:
            if attribute.name in ("to", "dtype") and attribute.i == TensorProto.FLOAT:
                attribute.i = TensorProto.FLOAT16
            # A Constant's readers have a float16 copy of it, those of FLOAT32_INPUTS the Constant itself.
            if attribute.t.data_type == TensorProto.FLOAT and node.op_type != "Constant":
                half = _half(numpy_helper.to_array(attribute.t))
                attribute.t.CopyFrom(numpy_helper.from_array(half, attribute.t.name))
        for name in node.output:
            if name in outputs:
                renamed[name] = graph.unique(f"{name}/fp16")
        graph.rewire(node, inputs, [renamed[name] if name in outputs else name for name in node.output])
    for name in outputs:
        graph.op("Cast", renamed[name], name=f"{name}/fp32", outputs=[name], to=TensorProto.FLOAT)
    del graph.model.graph.value_info[:]
    graph.prune()
    return graph.model


def _half(values: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):  # infinite then, as is the saliency, which is looked at
        return values.astype(np.float16)


def bfloat16_weights(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of `model` with its weights rounded to bfloat16, and cast to float32 where they are used.

    ONNX Runtime folds the casts when it loads the file: half the size on disk, and float32 arithmetic, except where a
    provider chooses bfloat16 itself.
    """
    graph = Graph(model)
    with graph.insert_before(graph.nodes[0]):
        for tensor in graph.model.graph.initializer:
            if tensor.data_type == TensorProto.FLOAT and np.prod(tensor.dims) >= MANY:
                name, stored = tensor.name, f"{tensor.name}/bf16"
                tensor.CopyFrom(_bfloat16(numpy_helper.to_array(tensor), stored))
                graph.op("Cast", stored, name=f"{name}/cast", outputs=[name], to=TensorProto.FLOAT)
    return graph.model


def _bfloat16(values: np.ndarray, name: str) -> TensorProto:
    """The upper halves of the float32 values, rounded to nearest, ties to even."""
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32).astype(np.uint64)
    rounded = ((bits + 0x7FFF + ((bits >> 16) & 1)) >> 16).astype(np.uint16)
    return helper.make_tensor(name, TensorProto.BFLOAT16, values.shape, rounded.tobytes(), raw=True)
