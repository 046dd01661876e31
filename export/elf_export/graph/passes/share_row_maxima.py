"""A max-pool from the row maxima that its adjoint compares anyway."""

from __future__ import annotations

import onnx
from onnx import helper

from elf_export.graph.graph import Graph

WHOLE = {"kernel_shape": [2, 2], "strides": [2, 2]}
ROWS = {"kernel_shape": [1, 2], "strides": [1, 2]}
COLUMNS = {"kernel_shape": [2, 1], "strides": [2, 1]}


def share_row_maxima(graph: Graph) -> Graph:
    """A 2x2 max-pool of x takes the maxima of x's rows of pairs, where they are computed.

    The maximum of four values is that of the two rows' maxima, exactly; reading those moves half as much memory as
    reading x.

    requires : nodes in the order in which they run.
    call : behind the adjoint, which makes the row maxima.
    ensures : the same bits; row maxima come before the first pool that takes them.
    """
    rows: dict[str, onnx.NodeProto] = {}
    for node in graph.nodes:
        if _is_pool(node, ROWS):
            rows.setdefault(node.input[0], node)
    made: set[str] = set()  # row maxima that come before the node that is looked at
    for node in list(graph.nodes):
        if _is_pool(node, WHOLE) and node.input[0] in rows:
            source = rows[node.input[0]].output[0]
            if source not in made:
                made.add(source)
                graph.move_before(graph.producers()[source], node)
            with graph.replace_node(node):
                graph.add(helper.make_node("MaxPool", [source], node.output, node.name, None, None, None, **COLUMNS))
        elif _is_pool(node, ROWS):
            made.add(node.output[0])
    return graph


def _is_pool(node: onnx.NodeProto, settings: dict[str, list[int]]) -> bool:
    """Whether `node` is a MaxPool of one output with these settings, no padding, and no other that matters."""
    if node.op_type != "MaxPool" or len(node.output) != 1:
        return False
    attributes = {a.name: helper.get_attribute_value(a) for a in node.attribute}
    plain = not attributes.pop("ceil_mode", 0) and not any(attributes.pop("pads", []))
    plain &= attributes.pop("auto_pad", b"NOTSET") in (b"NOTSET", b"VALID")
    plain &= set(attributes.pop("dilations", [1])) == {1} and not attributes.pop("storage_order", 0)
    return plain and attributes == settings
