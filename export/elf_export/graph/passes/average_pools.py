"""Max-pooling becomes average-pooling."""

from __future__ import annotations

from elf_export.errors import LayerError
from elf_export.graph.graph import Graph, attributes

_KEPT = ("kernel_shape", "strides", "pads", "auto_pad", "ceil_mode")


def average_pools(graph: Graph) -> Graph:
    """Each MaxPool becomes an AveragePool over the same windows; what is padded counts for nothing.

    requires : no MaxPool gives its indices to a node, or has dilated windows.
    call : on a forward graph, before its adjoint.
    ensures : every value has the shape that it had.

    Raises
    ------
    LayerError
        Without a MaxPool, or where one is as it is not required to be.
    """
    pools = [node for node in graph.nodes if node.op_type == "MaxPool"]
    if not pools:
        raise LayerError("--pool average: the network has no max-pooling up to its layers")
    for node in pools:
        given = attributes(node)
        if len([name for name in node.output if name]) > 1 or any(step != 1 for step in given.get("dilations", ())):
            raise LayerError(
                f"--pool average: {node.name or node.output[0]!r} has dilated windows or gives its indices"
            )
        kept = {name: given[name] for name in _KEPT if name in given}
        with graph.replace_node(node):
            graph.op("AveragePool", node.input[0], name=node.name or node.output[0], outputs=[node.output[0]], **kept)
    return graph
