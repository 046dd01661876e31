"""Compute what is computed twice once."""

from __future__ import annotations

import onnx

from .cut import cut


def share(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of `model` without nodes and initializers that are copies of earlier ones.

    Two nodes are copies if op, attributes and (after earlier merging) inputs are the same, two initializers
    if type, shape and values are.  Nodes with bodies, and nodes that make a graph output, are left alone.
    """
    result = onnx.ModelProto()
    result.CopyFrom(model)
    proto = result.graph
    outputs = {value.name for value in proto.output}
    same: dict[str, str] = {}
    first: dict[object, str] = {}
    for tensor in proto.initializer:
        nameless = onnx.TensorProto()
        nameless.CopyFrom(tensor)
        nameless.ClearField("name")
        nameless.ClearField("doc_string")
        original = first.setdefault(nameless.SerializeToString(deterministic=True), tensor.name)
        if original != tensor.name and tensor.name not in outputs:
            same[tensor.name] = original
    made: dict[object, onnx.NodeProto] = {}
    for node in proto.node:
        for i, name in enumerate(node.input):
            node.input[i] = same.get(name, name)
        if any(a.HasField("g") or a.graphs for a in node.attribute):
            continue
        attributes = sorted(a.SerializeToString(deterministic=True) for a in node.attribute)
        # An optional output that is left out counts as another node: it could not give what the other one's does.
        made_by = tuple(map(bool, node.output))
        key = (node.domain, node.op_type, tuple(node.input), tuple(attributes), made_by)
        original_node = made.setdefault(key, node)
        if original_node is not node and not outputs.intersection(node.output):
            same.update((name, its) for name, its in zip(node.output, original_node.output, strict=True) if name)
    return cut(result, [value.name for value in proto.output])
