"""Shapes of a graph that is edited: inferred when asked for, once, and without the weights."""

from __future__ import annotations

import numpy as np
import pytest
from onnx import shape_inference

from elf_export.graph.graph import Graph, GraphView

from .edited import model, require_consistent
from .test_graph import names


def test_a_constant_in_a_node_s_place_tells_more_of_shapes() -> None:
    sizes = {"two": np.array([2], np.int64), "rest": np.array([-1, 24], np.int64)}
    graph = Graph(
        model("s = Concat<axis = 0>(two, rest)  k = Identity(s)  y = Expand(x, k)  z = Relu(y)", "z", **sizes)
    )
    assert graph.rank("z") == 4
    graph.replace_by_constant(graph.producers()["k"], np.array([2, 3, 1, 8], np.int64))
    graph.prune()
    assert names(graph) == ["y", "z"]
    assert graph.shape("z") == [2, 3, "H", 8]
    require_consistent(graph)


def test_shapes_are_inferred_once(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = []
    right = shape_inference.infer_shapes
    monkeypatch.setattr(shape_inference, "infer_shapes", lambda *args, **kw: runs.append(1) or right(*args, **kw))
    graph = Graph(model(w=np.ones((4, 3), np.float32)))
    assert graph.shape("x") == ["N", 3, "H", 8]
    assert graph.shape("w") == [4, 3]
    assert not runs  # both are stated
    assert graph.shape("y") == graph.shape("a") == ["N", 3, "H", 8]
    with graph.replace_node(graph.producers()["b"]):
        graph.op("Abs", "a", name="other", outputs=["b"])
    assert graph.shape("b") == ["N", 3, "H", 8]
    assert graph.shape("never made") is None
    assert len(runs) == 1  # what took b's place is what b was
    flat = graph.op("Flatten", "y", name="flat")
    assert graph.shape("y") == ["N", 3, "H", 8]
    assert len(runs) == 1
    assert graph.rank(flat) == 2
    assert graph.rank(flat) == 2
    assert len(runs) == 2
    graph.retype("y")
    assert graph.shape("a") == ["N", 3, "H", 8]
    assert len(runs) == 2  # nothing above y has changed
    assert graph.rank(flat) == 2
    assert len(runs) == 3


def test_a_size_that_is_not_known_is_not_taken_for_another_one() -> None:
    graph = Graph(model("y = Flatten(x)"))  # H * 24
    (_, columns) = graph.shape("y")
    with graph.insert_before(graph.producers()["y"]):
        other = graph.op("Flatten", "x", name="other", axis=2)  # N * 3
    assert graph.shape(other)[0] != columns
    assert graph.shape(other)[0] != graph.shape("y")[1]


def test_inference_sees_shapes_and_no_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    right = shape_inference.infer_shapes
    monkeypatch.setattr(shape_inference, "infer_shapes", lambda m, **kw: seen.append(m.ByteSize()) or right(m, **kw))
    kernel, scales = np.ones((64, 3, 3, 3), np.float32), np.array([1, 1, 2, 2], np.float32)
    graph = GraphView(model('c = Conv(x, w)  y = Resize<mode = "nearest">(c, , scales)', w=kernel, scales=scales))
    assert graph.shape("y")[1::2] == [64, 12]
    assert max(seen) < kernel.nbytes / 4
