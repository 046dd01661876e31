"""Replace what is computed from constants alone by its value."""

from __future__ import annotations

import math

import numpy as np
import onnx
from onnx import helper
from onnx.reference import ReferenceEvaluator

from elf_export.graph.graph import Array, Graph

MOST_ELEMENTS = 1 << 20  # of a result: a large constant that is computed from small ones stays computed
MOST_STATED = 1024  # numbers of a tensor that inference may read a shape from
RANDOM = frozenset({"Bernoulli", "Multinomial"})
MOVES = frozenset({
    "ConstantOfShape", "Identity", "Reshape", "Flatten", "Squeeze", "Unsqueeze", "Transpose", "Slice", "Concat",
    "Expand", "Tile", "Gather",
})  # fmt: skip

GROWS = frozenset({
    "ConstantOfShape", "Expand", "Tile", "Range", "Pad", "Resize", "Upsample", "OneHot", "EyeLike", "Gather", "Add",
    "Sub", "Mul", "Div", "Equal", "Where",
})  # fmt: skip
"""Whose results may be larger than their inputs together."""


def fold_constants(graph: Graph) -> Graph:
    """Make initializers of numbers that are computed from constants alone.

    Exporters write the pads of a Pad or the bounds of a Slice as chains of ConstantOfShape, Concat, Reshape and Cast; a
    rule that needs the numbers finds them after this pass.

    requires : nodes in the order in which they run.
    call : before anything that asks for constants.
    ensures : integers and booleans are folded, and floats that are only moved, which no rounding can change.
    """
    for node in list(graph.nodes):
        values = {name: graph.constant(name) for name in node.input if name}
        if not values or any(v is None for v in values.values()) or len(node.output) != 1 or node.op_type in RANDOM:
            continue
        result = _evaluate(node, {n: v for n, v in values.items() if v is not None}, graph.opset)
        if result is None or not (result.dtype.kind in "iub" or node.op_type in MOVES):
            continue
        if result.size <= max(MOST_ELEMENTS, *(v.size for v in values.values() if v is not None)):
            graph.replace_by_constant(node, result)
    graph.prune()
    return graph


def _evaluate(node: onnx.NodeProto, values: dict[str, Array], opset: int) -> Array | None:
    """The output of a standard node, None if it has a body, is too large, or if nobody here can run it."""
    if node.domain not in ("", "ai.onnx") or any(a.HasField("g") for a in node.attribute):
        return None
    inputs = [
        helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(value.dtype), value.shape)
        for name, value in values.items()
    ]
    output = helper.make_tensor_value_info(node.output[0], onnx.TensorProto.UNDEFINED, None)
    graph = helper.make_graph([node], "fold", inputs, [output])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)])
    if node.op_type in GROWS and not _is_small(model, values):
        return None
    try:
        result = ReferenceEvaluator(model).run(None, values)
    except Exception:  # any failure of the evaluator leaves the node as it is
        return None
    first = result[0] if isinstance(result, list) else None
    return first if isinstance(first, np.ndarray) else None


def _is_small(model: onnx.ModelProto, values: dict[str, Array]) -> bool:
    """Whether the one node's result is known to have at most MOST_ELEMENTS, or as many as its inputs."""
    known = onnx.ModelProto()
    known.CopyFrom(model)
    for name, value in values.items():
        if value.size <= MOST_STATED:
            known.graph.initializer.append(onnx.numpy_helper.from_array(value, name))
    try:
        inferred = onnx.shape_inference.infer_shapes(known, data_prop=True)
    except Exception:  # whatever its C++ side throws
        return False
    kind = inferred.graph.output[0].type.tensor_type
    if not kind.HasField("shape") or not all(dim.HasField("dim_value") for dim in kind.shape.dim):
        return False
    size = math.prod(dim.dim_value for dim in kind.shape.dim)
    return bool(0 <= size <= max(MOST_ELEMENTS, *(value.size for value in values.values())))
