"""Editing a graph: who makes and reads what is known after every edit, and shapes are those of a fresh inference."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnx
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, parser

from elf_export.graph.graph import Graph, GraphView, captured

from .edited import model, require_consistent

IF = """<ir_version: 8, opset_import: ["" : 17]>
g (float[N,3,H,W] x, bool c) => (float[N,3,H,W] z) {
  a = Relu(x)
  y = If (c) <
    then_branch = t () => (float[N,3,H,W] p) { p = Neg(a) }, else_branch = e () => (float[N,3,H,W] q) { q = Abs(a) }
  >
  z = Add(a, y)
}"""


def names(graph: GraphView) -> list[str]:
    return [node.name for node in graph.nodes]


def test_the_model_that_is_given_is_not_changed() -> None:
    given_model = model()
    before = given_model.SerializeToString()
    graph = Graph(given_model)
    graph.replace_uses("a", "x")
    graph.prune()
    graph.op("Abs", "y", name="more")
    assert given_model.SerializeToString() == before
    view = GraphView(given_model)
    assert view.shape("b") == ["N", 3, "H", 8]
    assert given_model.SerializeToString() == before
    assert Graph(given_model, copy=False).model is given_model


def test_nodes_come_last_or_before_another() -> None:
    graph = Graph(model())
    last = graph.op("Abs", "y", name="last")
    with graph.insert_before(graph.producers()["b"]):
        first = graph.op("Abs", "a", name="first")
        graph.op("Abs", first, name="second")
        with graph.insert_before(None):
            graph.op("Abs", last, name="end")
    assert names(graph) == ["a", "first", "second", "b", "y", "last", "end"]
    require_consistent(graph)


def test_a_node_is_replaced_in_its_place() -> None:
    graph = Graph(model())
    node = graph.producers()["b"]
    with graph.replace_node(node):
        graph.op("Mul", node.input[0], graph.const(-1, "minus", np.float32), name="negated", outputs=["b"])
    assert names(graph) == ["a", "negated", "y"]
    assert [n.name for n in graph.consumers()["a"]] == ["y", "negated"]
    last = graph.producers()["y"]
    with graph.replace_node(last):
        graph.op("Sub", "a", "b", name="difference", outputs=["y"])
    assert names(graph) == ["a", "negated", "difference"]
    require_consistent(graph)


def test_uses_are_replaced_and_the_rest_is_pruned() -> None:
    graph = Graph(model("a = Relu(x)  b = Add(x, w)  y = Add(b, b)", w=np.ones(8, np.float32)))
    assert [node.name for node in graph.consumers()["b"]] == ["y", "y"]
    graph.replace_uses("b", "a")
    assert "b" not in graph.consumers()
    require_consistent(graph)
    graph.prune()
    assert names(graph) == ["a", "y"]
    assert not graph.model.graph.initializer
    assert not graph.is_constant("w")
    require_consistent(graph)


def test_bodies_read_too() -> None:
    graph = Graph(parser.parse_model(IF))
    assert [node.op_type for node in graph.consumers()["a"]] == ["If", "If", "Add"]
    graph.replace_uses("a", "x")
    branch = graph.producers()["y"]
    assert set(captured(branch)) == {"x"}
    assert "a" not in graph.consumers()
    graph.prune()
    assert [node.op_type for node in graph.nodes] == ["If", "Add"]
    graph.rename({"x": "pixels"})
    assert set(captured(graph.producers()["y"])) == {"pixels"}
    assert graph.inputs == ["pixels", "c"]
    onnx.checker.check_model(graph.model, full_check=True)
    graph.unique("p")
    assert graph.unique("p") == "p_3"  # a body's name is taken


def test_an_output_keeps_its_name() -> None:
    graph = Graph(model("a = Relu(x)  y = Neg(a)", "a y"))
    graph.replace_uses("a", "x")
    graph.prune()
    assert names(graph) == ["a", "y"]
    require_consistent(graph)


def test_a_node_is_rewired_and_moved() -> None:
    graph = Graph(model("a = Relu(x)  b = Neg(x)  y = Add(a, b)"))
    graph.move_before(graph.producers()["b"], graph.producers()["a"])
    assert names(graph) == ["b", "a", "y"]
    graph.rewire(graph.producers()["a"], inputs=["b"])
    require_consistent(graph)
    graph.remove(graph.producers()["y"])
    graph.rewire(graph.producers()["a"], outputs=["y"])
    assert [node.name for node in graph.producers().values()] == ["b", "a"]
    require_consistent(graph)
    graph.rewire(graph.producers()["b"], outputs=["new"])
    graph.rewire(graph.producers()["y"], inputs=["new"])
    require_consistent(graph)


def _grown(graph: Graph, data: st.DataObject, values: Sequence[str], name: str) -> None:
    """Add a random node that reads one of `values`."""
    op = data.draw(st.sampled_from(["Relu", "Neg", "Flatten", "Transpose", "Shape"]))
    x = data.draw(st.sampled_from(values))
    graph.op(op, x, name=name, **({"perm": [0, 1, 3, 2]} if op == "Transpose" else {}))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.data())
def test_after_any_edits_all_is_as_if_read_afresh(data: st.DataObject) -> None:
    graph = Graph(model("a = Relu(x)  b = Neg(a)  c = Add(a, b)  d = Abs(c)  y = Mul(c, d)"))
    for step in range(data.draw(st.integers(1, 8))):
        alike = [name for name in ["x", *graph.producers()] if graph.shape(name) == ["N", 3, "H", 8]]
        node = data.draw(st.sampled_from(list(graph.nodes)))
        edit = data.draw(st.sampled_from(["add", "before", "replace", "uses", "prune", "ask", "turn"]))
        at = names(graph).index(node.name)
        made = {name for other in list(graph.nodes)[:at] for name in other.output}
        before = [name for name in alike if name == "x" or name in made]
        if edit == "add":
            _grown(graph, data, alike, f"n{step}")
        elif edit == "before":
            with graph.insert_before(node):
                _grown(graph, data, before, f"n{step}")
        elif edit == "replace" and node.output[0] in alike:
            with graph.replace_node(node):
                graph.op("Sum", *before[-2:], name=f"n{step}", outputs=list(node.output))
        elif edit == "uses" and node.output[0] in alike:
            graph.replace_uses(node.output[0], data.draw(st.sampled_from(before)))
        elif edit == "turn" and node.op_type in ("Relu", "Neg", "Abs"):
            x, y = node.input[0], node.output[0]  # another thing of the same name, and so is what is made of it
            if not graph.consumers().get(y):
                with graph.replace_node(node):
                    graph.op("Cast", x, name=f"n{step}", outputs=[y], to=TensorProto.INT32)
                graph.retype(y)
        elif edit == "prune":
            graph.prune()
        require_consistent(graph)
