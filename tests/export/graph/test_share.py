"""What is computed twice is computed once, and nothing else is put in its place."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from elf_export.graph.graph import Graph
from elf_export.graph.passes import share
from elf_runtime.model.session import open_session


def pooled(first: list[str], second: list[str]) -> onnx.ModelProto:
    """Two equal max-pools of x with these outputs; y is the second one's maxima enlarged, z the first one's doubled."""
    form = {"kernel_shape": [2, 2], "strides": [2, 2]}
    nodes = [
        helper.make_node("MaxPool", ["x"], first, name="one", **form),
        helper.make_node("MaxPool", ["x"], second, name="two", **form),
        helper.make_node("Resize", [second[0], "", "scales"], ["y"], name="y", mode="nearest"),
        helper.make_node("Add", [first[0], first[0]], ["z"], name="z"),
    ]
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3, None, None]) for name in "xyz"]
    scales = numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32), "scales")
    graph = helper.make_graph(nodes, "g", infos[:1], infos[1:], [scales])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


@pytest.mark.parametrize(
    ("first", "second", "pools"),
    [
        (["a"], ["b"], 1),
        (["a", ""], ["b", ""], 1),
        (["a", "i"], ["b", "j"], 1),
        (["a", "i"], ["b", ""], 2),  # the absent output is nobody's name: it stands for no other
        (["a", ""], ["b", "j"], 2),
    ],
)
def test_optional_outputs(first: list[str], second: list[str], pools: int) -> None:
    model = pooled(first, second)
    shared = share(Graph(model)).model
    onnx.checker.check_model(shared, full_check=True)
    assert sum(node.op_type == "MaxPool" for node in shared.graph.node) == pools
    (resize,) = (node for node in shared.graph.node if node.op_type == "Resize")
    assert resize.input[1] == ""
    x = np.random.default_rng(0).standard_normal((1, 3, 6, 8)).astype(np.float32)
    runs = (open_session(m.SerializeToString())[0].run(None, {"x": x}) for m in (shared, model))
    for found, wanted in zip(*runs, strict=True):
        np.testing.assert_array_equal(found, wanted)
