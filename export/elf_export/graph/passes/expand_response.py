"""Local response normalisation as the convolution and the roots that its adjoint needs anyway."""

from __future__ import annotations

import onnx

from elf_export.graph.graph import Graph
from elf_export.graph.response import Response

from .share import share


def expand_response(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of `model` in which the LRN of a map is written as `response.Response` computes it.

    Where an adjoint computes the same sums and roots, both take them from one place.
    """
    graph = Graph(model)
    nodes = graph.model.graph.node
    old = [onnx.NodeProto.FromString(node.SerializeToString()) for node in nodes]
    del nodes[:]
    expanded = False
    for node in old:
        response = Response.of(graph, node) if node.op_type == "LRN" else None
        if response is None:
            nodes.append(node)
            continue
        name = node.name or node.output[0]
        power = response.power(response.denominator(name), name)
        graph.op("Div", response.x, power, name=f"{name}/normalized", outputs=list(node.output))
        expanded = True
    return share(graph.model) if expanded else model
