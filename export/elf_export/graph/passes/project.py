"""A descriptor map's channels projected inside the graph; free where a convolution makes the map."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper

from elf_export.graph.graph import Graph, attributes

Affine = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
"""matrix (D, d) and bias (d,): y = x @ matrix + bias"""


def project(graph: Graph, maps: Mapping[str, Affine], separate: bool = False) -> Graph:
    """Outputs (N, h, w, D), each made by a Transpose, become (N, h, w, d): a 1x1 convolution before it.

    Where a convolution W * x + b makes the map and nothing else reads it, no node is added:
    P^T (W * x + b) + c = (P^T W) * x + (P^T b + c), which is cheaper than before by D / d.

    requires : the outputs of a saliency graph; `maps` has an `Affine` for each that is to change.
    call : when all else is built; with `separate`, the convolution is added in any case.
    ensures : the other outputs are what they were.
    """
    for output, affine in maps.items():
        _project(graph, graph.producers()[output], affine, separate)
    graph.prune()
    return graph


def _project(graph: Graph, last: onnx.NodeProto, affine: Affine, separate: bool) -> None:
    matrix, bias = affine
    (output,) = last.output
    source = last.input[0]
    perm = attributes(last)["perm"]
    first = [perm[i] for i in (0, 3, 1, 2)]  # the source's axes in the order N, C, H, W
    made = graph.producers().get(source)
    free = not separate and len(graph.consumers()[source]) == 1 and source not in graph.outputs
    if free and made is not None and first == [0, 1, 2, 3] and _composed(graph, made, affine):
        projected = source
    else:
        if first != [0, 1, 2, 3]:
            source = graph.op("Transpose", source, name=f"{output}/channels_first", perm=first)
        kernel = graph.const(matrix.T[:, :, None, None], f"{output}/projection", np.float32)
        offset = graph.const(bias, f"{output}/offset", np.float32)
        projected = graph.op("Conv", source, kernel, offset, name=f"{output}/projected")
    graph.remove(last)
    graph.add(helper.make_node("Transpose", [projected], [output], name=last.name, perm=[0, 2, 3, 1]))
    for value in graph.model.graph.output:
        if value.name == output:
            value.type.tensor_type.shape.dim[3].dim_value = matrix.shape[1]
    del graph.model.graph.value_info[:]
    graph.retype(source, output)


def _composed(graph: Graph, conv: onnx.NodeProto, affine: Affine) -> bool:
    """Put the projection into the convolution that makes the map; False where it is none of one group."""
    matrix, bias = affine
    if conv.op_type != "Conv" or attributes(conv).get("group", 1) != 1:
        return False
    kernel = graph.constant(conv.input[1])
    given = graph.constant(conv.input[2]) if len(conv.input) > 2 and conv.input[2] else np.zeros(len(matrix))
    if kernel is None or given is None:
        return False
    name = conv.output[0]
    weights = np.einsum("od,oi...->di...", matrix, kernel.astype(np.float64))
    inputs = [
        conv.input[0],
        graph.const(weights, f"{name}/projected_weight", kernel.dtype),
        graph.const(given.astype(np.float64) @ matrix + bias, f"{name}/projected_bias", kernel.dtype),
    ]
    graph.rewire(conv, inputs)
    return True
