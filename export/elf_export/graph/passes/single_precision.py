"""Compute in float32 what a model computes in float16, bfloat16 or float64."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import onnx
from onnx import TensorProto, numpy_helper

from elf_export.graph.graph import nested_graphs

OTHER_FLOATS = (TensorProto.FLOAT16, TensorProto.BFLOAT16, TensorProto.DOUBLE)
# Attributes that name an element type: of Cast, of RandomNormal and EyeLike, of QuantizeLinear.
TYPE_ATTRIBUTES = ("to", "dtype", "output_dtype", "stash_type")


def single_precision(model: onnx.ModelProto, floating_inputs: Collection[str] = ()) -> onnx.ModelProto:
    """A copy of `model` whose floating-point values are all float32.

    A gradient in float16 overflows where the forward pass does not, and ONNX Runtime's CPU convolves in
    float32 alone; what the weights lost when they were rounded stays lost.

    requires : nothing; bodies are converted too.
    call : before shapes are asked for, and before the adjoint.
    ensures : `model` is not changed.

    Parameters
    ----------
    floating_inputs : names of inputs
        Made float32 whatever they are: a uint8 image has no gradient.
    """
    result = onnx.ModelProto()
    result.CopyFrom(model)
    for graph in nested_graphs(result.graph):
        for tensor in graph.initializer:
            _convert(tensor)
        for node in graph.node:
            for attribute in node.attribute:
                if attribute.type == onnx.AttributeProto.TENSOR:
                    _convert(attribute.t)
                elif attribute.name in TYPE_ATTRIBUTES and attribute.i in OTHER_FLOATS:
                    attribute.i = TensorProto.FLOAT
        for value in (*graph.input, *graph.output):
            kind = value.type.tensor_type
            if kind.elem_type in OTHER_FLOATS or value.name in floating_inputs:
                kind.elem_type = TensorProto.FLOAT
        del graph.value_info[:]
    return result


def _convert(tensor: TensorProto) -> None:
    if tensor.data_type in OTHER_FLOATS:
        values = numpy_helper.to_array(tensor).astype(np.float32)
        tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))
