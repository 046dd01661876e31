"""Local response normalisation as the convolution and the roots that its adjoint needs anyway."""

from __future__ import annotations

from elf_export.graph.graph import Graph
from elf_export.graph.response import Response

from .share import share


def expand_response(graph: Graph) -> Graph:
    """Write the LRN of a map as `response.Response` computes it.

    requires : shapes, for the number of channels; an LRN of something else stays.
    call : behind the adjoint, whose sums and roots are then taken from the same place as the forward pass's.
    ensures : the same values; nothing is computed twice if there was an LRN.
    """
    expanded = False
    for node in list(graph.nodes):
        response = Response.of(graph, node) if node.op_type == "LRN" else None
        if response is not None:
            name, expanded = node.name or node.output[0], True
            with graph.replace_node(node):
                power = response.power(response.denominator(name), name)
                graph.op("Div", response.x, power, name=f"{name}/normalized", outputs=list(node.output))
    return share(graph) if expanded else graph
