"""A max-pool from row maxima: the same values, and only where they are the same."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import helper
from onnx.reference import ReferenceEvaluator

from elf_export.graph.graph import Graph
from elf_export.graph.passes import share_row_maxima

ROWS = {"kernel_shape": [1, 2], "strides": [1, 2]}


def pools(**settings: object) -> onnx.ModelProto:
    """y = a 2x2 max-pool of x with these further settings; after it t = the maxima of x's pairs in a row."""
    nodes = [
        helper.make_node("MaxPool", ["x"], ["y"], name="pool", kernel_shape=[2, 2], strides=[2, 2], **settings),
        helper.make_node("MaxPool", ["x"], ["t"], name="rows", **ROWS),
    ]
    values = [helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["N", 3, None, None]) for name in "xyt"]
    graph = helper.make_graph(nodes, "g", values[:1], values[1:])
    return helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)])


@pytest.mark.parametrize("size", [(8, 6), (7, 9), (2, 2)])
def test_the_values_stay(size: tuple[int, int]) -> None:
    model, shared = pools(), share_row_maxima(Graph(pools())).model
    onnx.checker.check_model(shared, full_check=True)
    assert [node.name for node in shared.graph.node] == ["rows", "pool"]
    assert list(shared.graph.node[1].input) == ["t"]
    x = np.random.default_rng(0).standard_normal((2, 3, *size)).astype(np.float32)
    for found, wanted in zip(*(ReferenceEvaluator(m).run(None, {"x": x}) for m in (shared, model)), strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(
    "settings", [{"pads": [0, 0, 1, 1]}, {"ceil_mode": 1}, {"auto_pad": "SAME_UPPER"}, {"dilations": [2, 2]}]
)
def test_other_pools_are_left_alone(settings: dict[str, object]) -> None:
    model = pools(**settings)
    assert share_row_maxima(Graph(model)).model == model


@pytest.mark.parametrize("names", [("pool", "rows", "again"), ("", "", "")])
def test_row_maxima_of_the_model_s_own(names: tuple[str, str, str]) -> None:
    """In front of the pool or behind it, once or twice, with names or without: every value is made once."""
    whole = helper.make_node("MaxPool", ["x"], ["y"], name=names[0], kernel_shape=[2, 2], strides=[2, 2])
    row = helper.make_node("MaxPool", ["x"], ["t"], name=names[1], **ROWS)
    twice = helper.make_node("MaxPool", ["x"], ["s"], name=names[2], **ROWS)
    values = [helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["N", 3, None, None]) for name in "xyts"]
    x = np.random.default_rng(0).standard_normal((2, 3, 7, 8)).astype(np.float32)
    for nodes in ([row, whole, twice], [whole, row, twice], [row, twice, whole]):
        graph = helper.make_graph(nodes, "g", values[:1], values[1:])
        model = helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)])
        shared = share_row_maxima(Graph(model)).model
        onnx.checker.check_model(shared, full_check=True)
        assert len(shared.graph.node) == 3
        assert [n.input[0] for n in shared.graph.node if n.output[0] == "y"] == ["t"]
        for found, wanted in zip(*(ReferenceEvaluator(m).run(None, {"x": x}) for m in (shared, model)), strict=True):
            np.testing.assert_array_equal(found, wanted)
