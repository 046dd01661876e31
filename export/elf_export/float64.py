"""A forward pass in float64, by ONNX's reference evaluator: slow, and free of float32's rounding."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, numpy_helper
from onnx.reference import ReferenceEvaluator
from onnx.reference.op_run import OpRun

Array = npt.NDArray[Any]
Array64 = npt.NDArray[np.float64]


def float64_forward(model: onnx.ModelProto, image: str, output: str) -> Callable[[Array64], Array64]:
    """``f(x)``: the value `output` of a float32 model, computed in float64."""
    evaluator = ReferenceEvaluator(in_double(model), new_ops=STAND_INS)

    def forward(x: Array64) -> Array64:
        return np.asarray(evaluator.run([output], {image: x.astype(np.float64)})[0], np.float64)

    return forward


def in_double(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of a float32 model whose floats are float64; the same numbers, as every float32 is a float64."""
    result = onnx.ModelProto()
    result.CopyFrom(model)
    graph = result.graph
    for tensor in graph.initializer:
        _widen(tensor)
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.type == onnx.AttributeProto.TENSOR:
                _widen(attribute.t)
            elif attribute.name == "to" and attribute.i == TensorProto.FLOAT:
                attribute.i = TensorProto.DOUBLE
    for value in (*graph.input, *graph.output):
        if value.type.tensor_type.elem_type == TensorProto.FLOAT:
            value.type.tensor_type.elem_type = TensorProto.DOUBLE
    del graph.value_info[:]
    return result


def _widen(tensor: TensorProto) -> None:
    if tensor.data_type == TensorProto.FLOAT:
        values = numpy_helper.to_array(tensor).astype(np.float64)
        tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))


class BatchNormalization(OpRun):
    """The evaluator's takes the batch's own mean in the opsets below 14, whenever the node has a momentum."""

    op_domain = ""

    def _run(
        self, x: Array, scale: Array, bias: Array, mean: Array, var: Array, epsilon: float = 1e-5, **_: Any
    ) -> tuple[Array]:
        shape = [-1, *[1] * (x.ndim - 2)]
        factor = scale / np.sqrt(var + float(epsilon))
        return ((x - mean.reshape(shape)) * factor.reshape(shape) + bias.reshape(shape),)


class Erf(OpRun):
    """The evaluator's gives float32."""

    op_domain = ""

    def _run(self, x: Array) -> tuple[Array]:
        return (np.vectorize(math.erf, otypes=[np.float64])(x),)


class LRN(OpRun):
    """The evaluator's gives float32."""

    op_domain = ""

    def _run(self, x: Array, alpha: float = 1e-4, beta: float = 0.75, bias: float = 1.0, size: int = 1) -> tuple[Array]:
        before, behind = (size - 1) // 2, math.ceil((size - 1) / 2)
        squares = np.pad(x * x, [(0, 0), (before, behind), *[(0, 0)] * (x.ndim - 2)])
        total = sum(squares[:, i : i + x.shape[1]] for i in range(size))
        return (x / (float(bias) + float(alpha) / size * total) ** float(beta),)


STAND_INS = [BatchNormalization, Erf, LRN]
