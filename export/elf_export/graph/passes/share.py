"""Compute what is computed twice once."""

from __future__ import annotations

import onnx

from elf_export.graph.graph import Graph, bodies


def share(graph: Graph) -> Graph:
    """Remove nodes and initializers that are copies of earlier ones.

    Two nodes are copies if op, attributes and (after earlier merging) inputs are the same, two initializers
    if type, shape and values are.

    requires : nodes in the order in which they run.
    call : behind a pass that may have written the same thing twice.
    ensures : the same outputs.  Nodes with bodies, and nodes that make a graph output, are left alone.
    """
    outputs = set(graph.outputs)
    first: dict[bytes, str] = {}
    for tensor in graph.model.graph.initializer:
        original = first.setdefault(_content(tensor), tensor.name)
        if original != tensor.name and tensor.name not in outputs:
            graph.replace_uses(tensor.name, original)
    made: dict[object, onnx.NodeProto] = {}
    for node in graph.nodes:
        if bodies(node):
            continue
        attributes = sorted(a.SerializeToString(deterministic=True) for a in node.attribute)
        # An optional output that is left out counts as another node: it could not give what the other one's does.
        made_by = tuple(map(bool, node.output))
        key = (node.domain, node.op_type, tuple(node.input), tuple(attributes), made_by)
        original_node = made.setdefault(key, node)
        if original_node is not node and not outputs.intersection(node.output):
            for name, its in zip(node.output, original_node.output, strict=True):
                if name:
                    graph.replace_uses(name, its)
    graph.prune()
    return graph


def _content(tensor: onnx.TensorProto) -> bytes:
    """All that a tensor says but for its name."""
    nameless = onnx.TensorProto()
    nameless.CopyFrom(tensor)
    nameless.ClearField("name")
    nameless.ClearField("doc_string")
    content: bytes = nameless.SerializeToString(deterministic=True)
    return content
