"""Counting a graph's arithmetic and parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence

import onnx
from onnx import shape_inference

from .graph import Graph, attributes
from .passes import cut

PROBE = 512  # pixels of height and width; divisible by every usual stride


def macs_per_pixel(model: onnx.ModelProto, outputs: Sequence[str]) -> float:
    """Multiply-adds per image pixel that `outputs` need: Conv, ConvTranspose, Gemm and MatMul.

    Counted on an image of 512x512 pixels with the model's (N, H, W, C) input.
    """
    needed = cut(model, outputs)
    fixed = needed.graph.input[0].type.tensor_type.shape.dim
    for dim, size in zip(fixed, (1, PROBE, PROBE), strict=False):
        dim.dim_value = size
    del needed.graph.value_info[:]
    graph = Graph(shape_inference.infer_shapes(needed, data_prop=True))
    return sum(_macs(graph, node) for node in graph.nodes) / PROBE**2


def parameters(model: onnx.ModelProto) -> int:
    """Number of values in all initializers, those of the adjoint included."""
    return sum(math.prod(t.dims) for t in model.graph.initializer)


def _macs(graph: Graph, node: onnx.NodeProto) -> float:
    def dims(name: str) -> list[int]:
        return [d if isinstance(d, int) else 1 for d in graph.shape(name) or []]

    if node.op_type == "Conv":
        return math.prod(dims(node.output[0])) * math.prod(dims(node.input[1])[1:])
    if node.op_type == "ConvTranspose":
        return math.prod(dims(node.input[0])) * math.prod(dims(node.input[1])[1:])
    if node.op_type == "MatMul":
        return math.prod(dims(node.output[0])) * dims(node.input[0])[-1]
    if node.op_type == "Gemm":
        return math.prod(dims(node.output[0])) * dims(node.input[0])[0 if attributes(node).get("transA") else -1]
    return 0
