"""Put nodes in the order in which they run."""

from __future__ import annotations

import heapq

import onnx

from elf_export.errors import ExportError
from elf_export.graph.graph import Graph, captured, nested_graphs


def sort_nodes(graph: Graph) -> Graph:
    """Put every node behind those whose results it reads, in bodies too.

    ONNX demands it and converters to float16 forget it.

    requires : every value has one maker.
    call : on a model from a file, before all other passes.
    ensures : nodes that are in order keep their places; those without an output are left out.

    Raises
    ------
    ExportError
        If nodes wait for one another in a circle.
    """
    for proto in nested_graphs(graph.model.graph):
        nodes = [node for node in proto.node if any(node.output)]
        order = _order(nodes)
        if len(order) < len(proto.node) or order != sorted(order):
            copies = [onnx.NodeProto() for _ in order]
            for copy, index in zip(copies, order, strict=True):
                copy.CopyFrom(nodes[index])
            del proto.node[:]
            proto.node.extend(copies)
    graph.reindex()
    return graph


def _order(nodes: list[onnx.NodeProto]) -> list[int]:
    """Indices such that each node's makers come first; of those that are ready the first in the file goes first."""
    maker = {name: index for index, node in enumerate(nodes) for name in node.output if name}
    needs = [{maker[name] for name in (*node.input, *captured(node)) if name in maker} for node in nodes]
    waiting = [len(need) for need in needs]
    readers: dict[int, list[int]] = {}
    for index, need in enumerate(needs):
        for other in need:
            readers.setdefault(other, []).append(index)
    ready = [index for index, count in enumerate(waiting) if count == 0]
    order: list[int] = []
    while ready:
        index = heapq.heappop(ready)
        order.append(index)
        for reader in readers.get(index, ()):
            waiting[reader] -= 1
            if waiting[reader] == 0:
                heapq.heappush(ready, reader)
    if len(order) < len(nodes):
        stuck = next(index for index, count in enumerate(waiting) if count > 0)
        name = nodes[stuck].name or nodes[stuck].output[0]
        raise ExportError(f"not a valid ONNX model: node {name[:80]!r} waits for its own result, in a circle of nodes")
    return order
