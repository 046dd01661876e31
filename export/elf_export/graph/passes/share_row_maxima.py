"""A max-pool from the row maxima that its adjoint compares anyway."""

from __future__ import annotations

import onnx
from onnx import helper

WHOLE = {"kernel_shape": [2, 2], "strides": [2, 2]}
ROWS = {"kernel_shape": [1, 2], "strides": [1, 2]}
COLUMNS = {"kernel_shape": [2, 1], "strides": [2, 1]}


def share_row_maxima(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of `model` in which a 2x2 max-pool of x takes the maxima of x's rows of pairs, where they are computed.

    The maximum of four values is that of the two rows' maxima, exactly; reading those moves half as much memory as
    reading x.
    """
    result = onnx.ModelProto()
    result.CopyFrom(model)
    rows: dict[str, onnx.NodeProto] = {}
    for node in model.graph.node:
        if _is_pool(node, ROWS):
            rows.setdefault(node.input[0], node)
    nodes: list[onnx.NodeProto] = []
    placed: set[str] = set()  # results of row maxima that stand in `nodes` already
    for node in model.graph.node:
        if _is_pool(node, WHOLE) and node.input[0] in rows:
            source = rows[node.input[0]]
            if source.output[0] not in placed:
                placed.add(source.output[0])
                nodes.append(source)
            node = helper.make_node("MaxPool", source.output, node.output, node.name)
            node.attribute.extend(helper.make_attribute(name, value) for name, value in COLUMNS.items())
        if _is_pool(node, ROWS):
            if node.output[0] in placed:
                continue
            placed.add(node.output[0])
        nodes.append(node)
    del result.graph.node[:]
    result.graph.node.extend(nodes)
    return result


def _is_pool(node: onnx.NodeProto, settings: dict[str, list[int]]) -> bool:
    """Whether `node` is a MaxPool of one output with these settings, no padding, and no other that matters."""
    if node.op_type != "MaxPool" or len(node.output) != 1:
        return False
    attributes = {a.name: helper.get_attribute_value(a) for a in node.attribute}
    plain = not attributes.pop("ceil_mode", 0) and not any(attributes.pop("pads", []))
    plain &= attributes.pop("auto_pad", b"NOTSET") in (b"NOTSET", b"VALID")
    plain &= set(attributes.pop("dilations", [1])) == {1} and not attributes.pop("storage_order", 0)
    return plain and attributes == settings
