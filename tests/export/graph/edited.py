"""A graph to edit, and what must hold of it after each edit."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper, parser

from elf_export.graph.graph import Graph, GraphView


def model(
    body: str = "a = Relu(x)  b = Neg(a)  y = Add(a, b)", outputs: str = "y", **tensors: np.ndarray
) -> onnx.ModelProto:
    """Of an input x, (N, 3, H, 8), in ONNX's textual form; nodes are called like their results."""
    nodes = list(parser.parse_graph(f"g (float x) => (float y) {{ {body} }}").node)
    for node in nodes:
        node.name = node.output[0]
    infos = [helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", 3, "H", 8])]
    outs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in outputs.split()]
    values = [numpy_helper.from_array(value, name) for name, value in tensors.items()]
    graph = helper.make_graph(nodes, "g", infos, outs, values)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def require_consistent(graph: Graph) -> None:
    """Who makes and reads what, and what is constant, as a graph that is read afresh has it."""
    fresh = GraphView(graph.model)
    assert {name: node.name for name, node in graph.producers().items()} == {
        name: node.name for name, node in fresh.producers().items()
    }
    assert all(any(node is other for other in graph.nodes) for node in graph.producers().values())
    assert _readers(graph) == _readers(fresh)
    assert all(any(node is other for other in graph.nodes) for nodes in graph.consumers().values() for node in nodes)
    symbols: dict[object, object] = {}  # inference numbers the sizes that it can't tell: in another graph, otherwise
    values = [*graph.producers(), *graph.inputs, *(t.name for t in graph.model.graph.initializer)]
    for name in values:
        graph.shape(name)  # what the last edit has made is inferred now, and nothing later on
    for name in values:
        assert graph.is_constant(name) == fresh.is_constant(name)
        assert np.array_equal(graph.constant(name), fresh.constant(name)) or not graph.is_constant(name)
        assert graph.elem_type(name) == fresh.elem_type(name)
        assert graph.rank(name) == fresh.rank(name)
        for found, wanted in zip(graph.shape(name) or [], fresh.shape(name) or [], strict=True):
            unknown = str(found).startswith("unk__") and str(wanted).startswith("unk__")
            assert symbols.setdefault(found, wanted) == wanted if unknown else found == wanted, name
    assert len(set(symbols.values())) == len(symbols)


def _readers(graph: GraphView) -> dict[str, list[str]]:
    return {name: sorted(node.name for node in nodes) for name, nodes in graph.consumers().items()}
