"""Counting a graph's arithmetic and parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import onnx
from onnx import helper

from elf_export.errors import ExportError
from elf_runtime.errors import first_line
from elf_runtime.model.session import open_session

from .graph import Graph, GraphView, attributes

PROBE = 512  # pixels of height and width; divisible by every usual stride
COUNTED = frozenset({"Conv", "ConvTranspose", "MatMul", "Gemm"})


def macs(graph: GraphView) -> list[float]:
    """Multiply-adds of each node of a graph whose input has a static size.

    Raises
    ------
    ExportError
        As `sizes_of`, of the counted nodes' inputs and outputs.
    """
    sizes = sizes_of(graph, counted_values(graph.nodes))
    return [node_macs(sizes, node) for node in graph.nodes]


def counted_values(nodes: Iterable[onnx.NodeProto]) -> list[str]:
    """The inputs and outputs of the nodes that `node_macs` counts."""
    return [name for node in nodes if node.op_type in COUNTED for name in (*node.input, *node.output) if name]


def sizes_of(graph: GraphView, names: Sequence[str]) -> dict[str, list[int]]:
    """The sizes of tensors, in a graph whose input has a static size.

    What shape inference does not tell, a run of the model on zeros does.

    Raises
    ------
    ExportError
        If that is needed and the model does not run.
    """
    sizes = _inferred(graph, names)
    unknown = [name for name in dict.fromkeys(names) if name not in sizes]
    return sizes | _measured(graph, unknown) if unknown else sizes


def sizes_where_known(graph: GraphView) -> dict[str, list[int]]:
    """As `sizes_of`, of all values; those that only a run would tell are left out where the model does not run."""
    names = [
        name
        for name in (
            *(v.name for v in graph.model.graph.input),
            *(n for node in graph.nodes for n in node.output),
        )
        if name
    ]
    names += [name for name in counted_values(graph.nodes) if graph.is_constant(name)]
    try:
        return sizes_of(graph, names)
    except ExportError:
        return _inferred(graph, names)


def _inferred(graph: GraphView, names: Iterable[str]) -> dict[str, list[int]]:
    """The sizes that shape inference tells."""
    known: dict[str, list[int]] = {}
    for name in names:
        shape = graph.shape(name)
        sizes = [dim for dim in shape or [] if isinstance(dim, int)]
        if shape is not None and len(sizes) == len(shape):
            known[name] = sizes
    return known


def _measured(graph: GraphView, names: Sequence[str]) -> dict[str, list[int]]:
    """The sizes that values have when the model runs on zeros."""
    probe = Graph(graph.part(names), copy=False)
    outputs = [probe.op("Shape", name, name=f"{name}/measured") for name in names]
    probe.set_outputs([helper.make_tensor_value_info(name, onnx.TensorProto.INT64, [None]) for name in outputs])
    try:
        session, _ = open_session(probe.model.SerializeToString())
        zeros = {source.name: np.zeros(source.shape, np.float32) for source in session.get_inputs()}
        found = session.run(outputs, zeros)
    except Exception as error:  # onnxruntime's own exceptions share no base of theirs
        reason = first_line(error)
        raise ExportError(f"the model does not run on an image of zeros: {reason}") from error
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


def node_macs(sizes: Mapping[str, Sequence[int]], node: onnx.NodeProto) -> float:
    """Multiply-adds of one node; `sizes` are those of its inputs and outputs."""
    if node.op_type == "Conv":
        return math.prod(sizes[node.output[0]]) * math.prod(sizes[node.input[1]][1:])
    if node.op_type == "ConvTranspose":
        return math.prod(sizes[node.input[0]]) * math.prod(sizes[node.input[1]][1:])
    if node.op_type == "MatMul":
        return math.prod(sizes[node.output[0]]) * sizes[node.input[0]][-1]
    if node.op_type == "Gemm":
        return math.prod(sizes[node.output[0]]) * sizes[node.input[0]][0 if attributes(node).get("transA") else -1]
    return 0
