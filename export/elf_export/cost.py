"""Counting a graph's arithmetic and parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import onnx
from onnx import helper

from elf_runtime.session import open_session

from .graph import Graph, attributes
from .passes import cut

PROBE = 512  # pixels of height and width; divisible by every usual stride


def macs_per_pixel(model: onnx.ModelProto, outputs: Sequence[str]) -> float:
    """Multiply-adds per image pixel that `outputs` need: Conv, ConvTranspose, Gemm and MatMul.

    Counted on one image of 512x512 pixels, or of the size that the model's (N, H, W, C) input fixes.
    """
    needed = cut(model, outputs)
    height, width = fix_sizes(needed, needed.graph.input[0].name, "NHWC")
    return sum(macs(needed)) / (height * width)


def macs(model: onnx.ModelProto) -> list[float]:
    """Multiply-adds of each node of a model whose input has a static size.

    What shape inference does not tell, a run of the model on zeros does.
    """
    graph = Graph(model)
    counted = [node.output[0] for node in graph.nodes if node.op_type in ("Conv", "MatMul", "Gemm")]
    unknown = [name for name in counted if any(not isinstance(dim, int) for dim in graph.shape(name) or [None])]
    if unknown:
        sizes = _measured(graph, unknown)
        for name, dims in sizes.items():
            graph.model.graph.value_info.append(helper.make_tensor_value_info(name, graph.elem_type(name), dims))
        graph = Graph(graph.model)
    return [node_macs(graph, node) for node in graph.nodes]


def _measured(graph: Graph, names: Sequence[str]) -> dict[str, list[int]]:
    """The sizes that values have when the model runs on zeros."""
    probe = Graph(graph.model)
    outputs = [probe.op("Shape", name, name=f"{name}/measured") for name in names]
    del probe.model.graph.output[:]
    probe.model.graph.output.extend(
        helper.make_tensor_value_info(name, onnx.TensorProto.INT64, [None]) for name in outputs
    )
    session, _ = open_session(probe.model.SerializeToString())
    (source,) = session.get_inputs()
    found = session.run(outputs, {source.name: np.zeros(source.shape, np.float32)})
    return {name: [int(size) for size in dims] for name, dims in zip(names, found, strict=True)}


def fix_sizes(model: onnx.ModelProto, image: str, layout: str, size: int = PROBE) -> tuple[int, int]:
    """Give the free axes of the input `image` the sizes 1 and `size`; returns its height and width."""
    (value,) = (value for value in model.graph.input if value.name == image)
    wanted = {"N": 1, "H": size, "W": size}
    sizes: dict[str, int] = {}
    for axis, dim in zip(layout, value.type.tensor_type.shape.dim, strict=True):
        if axis in wanted and dim.dim_value <= 0:
            dim.dim_value = wanted[axis]
        sizes[axis] = dim.dim_value
    del model.graph.value_info[:]
    for output in model.graph.output:
        output.type.tensor_type.ClearField("shape")
    return sizes["H"], sizes["W"]


def parameters(model: onnx.ModelProto) -> int:
    """Number of values in all initializers, those of the adjoint included."""
    return sum(math.prod(t.dims) for t in model.graph.initializer)


def node_macs(graph: Graph, node: onnx.NodeProto) -> float:
    """Multiply-adds of one node, of a graph whose sizes are static."""

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
