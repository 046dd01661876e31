"""Seeded stand-ins for trained weights, and float64 copies of a graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, numpy_helper
from onnx.reference import ReferenceEvaluator
from onnx.reference.op_run import OpRun

Tensors = dict[str, npt.NDArray[np.float32]]


def seeded_weights(shapes: Mapping[str, Sequence[int]], seed: int = 0) -> Tensors:
    """Kernels that keep the variance of what they pass, normalisations near the identity."""
    rng = np.random.default_rng(seed)
    tensors: Tensors = {}
    for name, shape in shapes.items():
        role = name.rsplit(".", 1)[1]
        if len(shape) > 1:
            values = rng.standard_normal(shape) * np.sqrt(2 / np.prod(shape[1:]))
        elif role in ("weight", "running_var"):
            values = rng.uniform(0.7, 1.3, shape)
        else:
            values = 0.1 * rng.standard_normal(shape)
        tensors[name] = values.astype(np.float32)
    return tensors


def as_float64(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same graph with every float32 tensor, attribute and value in float64."""
    double = onnx.ModelProto()
    double.CopyFrom(model)
    constants = [a.t for node in double.graph.node for a in node.attribute if a.HasField("t")]
    for tensor in (*double.graph.initializer, *constants):
        if tensor.data_type == TensorProto.FLOAT:
            values = numpy_helper.to_array(tensor).astype(np.float64)
            tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))
    for node in double.graph.node:
        for attribute in node.attribute:
            if node.op_type == "Cast" and attribute.name == "to" and attribute.i == TensorProto.FLOAT:
                attribute.i = TensorProto.DOUBLE
    for value in (*double.graph.input, *double.graph.output):
        value.type.tensor_type.elem_type = TensorProto.DOUBLE
    return double


class LRN(OpRun):
    """The operator as specified; onnx's own evaluator fills only as many channels as there are images."""

    op_domain = ""

    def _run(
        self, x: npt.NDArray[np.float64], alpha: float, beta: float, bias: float, size: int
    ) -> tuple[npt.NDArray[np.float64]]:
        squares = np.pad(x * x, ((0, 0), ((size - 1) // 2, size // 2), (0, 0), (0, 0)))
        sums = np.lib.stride_tricks.sliding_window_view(squares, size, axis=1).sum(-1)
        return (x / (bias + alpha / size * sums) ** beta,)


def evaluator64(model: onnx.ModelProto) -> ReferenceEvaluator:
    """An evaluator of `model` in float64."""
    return ReferenceEvaluator(as_float64(model), new_ops=[LRN])
