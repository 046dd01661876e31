"""Write the ops that ONNX Runtime fuses and quantises in standard ones."""

from __future__ import annotations

from elf_export.graph.graph import Graph

from .fused_ops import FUSED
from .quantized_ops import QUANTIZED
from .writer import Writer

OPS = FUSED | QUANTIZED


def standard_ops(graph: Graph) -> Graph:
    """Write ops of OPS, fused or quantised, as chains of standard ones of the same values.

    requires : nothing; only nodes of the main graph are looked at.
    call : first of all, so that rules and other passes meet standard ops only.
    ensures : no op of OPS is left.
    """
    for node in list(graph.nodes):
        write = OPS.get((node.domain, node.op_type))
        if write is not None:
            with graph.replace_node(node):
                write(Writer(graph, node))
    return graph
