"""What the engine does for every rule: paths, accumulation, un-broadcasting, the seed, preflight."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import parser

from elf_export.adjoint import adjoint, build_adjoint, no_gradient, nodes_between, supported_ops
from elf_export.errors import LayerError, UnsupportedGraphError
from elf_export.graph.graph import Graph

from .oracles import assert_standard
from .runs import run_ort, with_adjoint

pytestmark = pytest.mark.torch


def model(body: str, inputs: str = "float[N,C,H,W] x", opset: int = 17, constants: str = "") -> onnx.ModelProto:
    """A model in ONNX's textual form; its output is y."""
    head = f'<ir_version: 8, opset_import: ["": {opset}]>\n'
    text = f"{head} g ({inputs}) => (float[a,b,c,d] y) {f'<{constants}>' if constants else ''} {{ {body} }}"
    made = parser.parse_model(text)
    for i, node in enumerate(made.graph.node):
        node.name = f"node_{i}"
    return made


def draw(*shape: int, seed: int = 0) -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.random.default_rng(seed).standard_normal(shape).astype(np.float32)


def gradient(made: onnx.ModelProto, feed: dict[str, Any], wrt: str = "x") -> Any:
    both = with_adjoint(made, wrt)
    assert_standard(both)
    return run_ort(both, feed)[1]


def by_torch(function: Any, x: Any, seed: Any) -> Any:
    leaf = torch.tensor(x, dtype=torch.float64, requires_grad=True)
    (grad,) = torch.autograd.grad(function(leaf), leaf, torch.tensor(seed, dtype=torch.float64))
    return grad.numpy()


@pytest.mark.parametrize("opset", [11, 13, 17, 20])
def test_several_uses_add_up(opset: int) -> None:
    made = model("a = Relu(x)  b = Mul(a, a)  c = Sigmoid(a)  d = Add(b, c)  y = Add(d, x)", opset=opset)
    x, seed = draw(2, 3, 4, 5), draw(2, 3, 4, 5, seed=1)
    expected = by_torch(lambda v: v.relu() ** 2 + v.relu().sigmoid() + v, x, seed)
    np.testing.assert_allclose(gradient(made, {"x": x, "seed": seed}), expected, atol=1e-5)


def test_a_residual_block_with_symbolic_sizes_needs_no_run_time_sum() -> None:
    """Whether a sum repeats an operand is proved from the convolutions' geometry."""
    body = """c = Conv<kernel_shape=[3,3], pads=[1,1,1,1]>(x, w)  r = Relu(c)
              p = MaxPool<kernel_shape=[2,2], strides=[2,2]>(r)
              q = MaxPool<kernel_shape=[2,2], strides=[2,2]>(x)
              k = Conv<kernel_shape=[3,3], pads=[0,0,0,0]>(p, w)
              l = Conv<kernel_shape=[3,3]>(q, w)  y = Add(k, l)"""
    made = model(body, "float[N,2,H,W] x, float[2,2,3,3] w", opset=11)
    graph = Graph(made)
    build_adjoint(graph, "y", "x")
    assert not [n.op_type for n in graph.nodes if n.op_type in ("ReduceSum", "NonZero")]


@pytest.mark.parametrize("own", [1, 4])
def test_broadcasting_that_only_the_run_knows(own: int) -> None:
    made = model("y = Mul(x, b)", "float[N,C,H,W] x, float[M,D,J,K] b", opset=13)
    x, b, seed = draw(2, 3, own, 1), draw(1, 3, 4, 5, seed=1), draw(2, 3, 4, 5, seed=2)
    expected = by_torch(lambda v: v * torch.tensor(b), x, seed)
    dx = gradient(made, {"x": x, "b": b, "seed": seed})
    assert dx.shape == x.shape
    np.testing.assert_allclose(dx, expected, atol=1e-5)


def test_broadcasting_that_only_the_run_knows_is_reported_before_opset_13() -> None:
    made = model("y = Mul(x, b)", "float[N,C,H,W] x, float[M,D,J,K] b", opset=12)
    with pytest.raises(UnsupportedGraphError, match=r"run time only.*opset 13"):
        build_adjoint(Graph(made), "y", "x")


@pytest.mark.parametrize("opset", [11, 13])
def test_sizes_of_one_are_summed(opset: int) -> None:
    made = model("b = Identity(x)  y = Add(b, z)", "float[1,C,1,W] x, float[N,C,H,W] z", opset=opset)
    x, z, seed = draw(1, 3, 1, 5), draw(2, 3, 4, 5, seed=1), draw(2, 3, 4, 5, seed=2)
    dx = gradient(made, {"x": x, "z": z, "seed": seed})
    np.testing.assert_allclose(dx, seed.sum((0, 2), keepdims=True), atol=1e-5)


def test_dead_branches_do_not_count() -> None:
    """Nodes beside the path, ops without a rule among them, are neither reported nor differentiated."""
    body = """a = Relu(x)  s = Shape(a)  i = Cast<to=7>(x)  j = Cast<to=1>(i)  u = Det(z)  v = Floor(x)
              k = Add(j, v)  b = Mul(a, k)  t = Asin(x)  y = Identity(b)"""
    made = model(body, "float[N,C,H,W] x, float[3,3] z")
    graph = Graph(made)
    assert [n.op_type for n in nodes_between(graph, "x", "y")] == ["Relu", "Mul", "Identity"]
    x, seed = 3 * draw(2, 3, 4, 5), draw(2, 3, 4, 5, seed=1)
    factor = np.trunc(x) + np.floor(x)
    both = with_adjoint(made, "x")
    dx = run_ort(both, {"x": x, "z": np.eye(3, dtype=np.float32), "seed": seed})[1]
    np.testing.assert_allclose(dx, seed * factor * (x > 0), rtol=1e-5)


def test_the_layer_is_the_default_seed() -> None:
    graph = Graph(model("y = Tanh(x)"))
    result = build_adjoint(graph, "y", "x")
    graph.op("Identity", result, name="result", outputs=["dx"])
    graph.model.graph.output.append(onnx.helper.make_tensor_value_info("dx", 1, ["N", "C", "H", "W"]))
    x = draw(2, 3, 4, 5)
    y, dx = run_ort(graph.model, {"x": x})
    np.testing.assert_allclose(dx, y * (1 - y * y), atol=1e-6)


def test_the_gradient_of_a_value_by_itself_is_the_seed() -> None:
    graph = Graph(model("y = Relu(x)"))
    assert build_adjoint(graph, "x", "x") == "x"
    assert build_adjoint(graph, "y", "y", seed="x") == "x"


def test_gradients_by_a_value_inside_the_graph() -> None:
    both = with_adjoint(model("a = Relu(x)  b = Exp(a)  y = Mul(b, a)"), "a")
    x, seed = draw(2, 3, 4, 5), draw(2, 3, 4, 5, seed=1)
    a = np.maximum(x, 0)
    np.testing.assert_allclose(run_ort(both, {"x": x, "seed": seed})[1], seed * np.exp(a) * (1 + a), rtol=1e-5)


def test_preflight_lists_all_nodes_at_once_and_appends_nothing() -> None:
    body = """a = Det(x)  b = Asin(x)  c = Relu(b)  d = com.example.Magic(c)  e = Acos(d)
              f = Resize<antialias=1, mode="linear">(e, , s)  y = Add(f, a)"""
    made = model(body, "float[N,C,H,W] x", opset=18, constants="float[4] s = {1, 1, 2, 2}")
    made.opset_import.append(onnx.helper.make_opsetid("com.example", 1))
    graph = Graph(made)
    before = graph.model.SerializeToString()
    with pytest.raises(UnsupportedGraphError) as caught:
        build_adjoint(graph, "y", "x")
    assert graph.model.SerializeToString() == before
    found = {(n.op, n.name, n.opset) for n in caught.value.nodes}
    assert {
        ("Det", "node_0", 18),
        ("Asin", "node_1", 18),
        ("Magic", "node_3", 18),
        ("Acos", "node_4", 18),
    } <= found
    reasons = {n.op: n.reason for n in caught.value.nodes}
    assert reasons["Asin"] == "no rule"
    assert "com.example" in reasons["Magic"]
    assert reasons["Resize"] == "antialias=1"
    for word in ("Asin", "node_4", "opset 18", "antialias", "Supported are", "Relu"):
        assert word in str(caught.value)


def test_an_image_in_a_place_for_constants_is_reported() -> None:
    made = model("y = Conv<kernel_shape=[3,3]>(z, x)", "float[2,2,3,3] x, float[1,2,5,5] z")
    with pytest.raises(UnsupportedGraphError, match="its input 'x' depends on the image"):
        build_adjoint(Graph(made), "y", "x")


def test_a_second_output_without_a_rule_is_reported() -> None:
    made = model("v, m = LayerNormalization(x, s)  y = Mul(v, m)", "float[2,3,4,5] x, float[5] s")
    with pytest.raises(UnsupportedGraphError, match="its output 'm' is used"):
        build_adjoint(Graph(made), "y", "x")


def test_an_old_opset_is_reported() -> None:
    with pytest.raises(UnsupportedGraphError, match="opset 11 or later"):
        build_adjoint(Graph(model("y = Relu(x)", opset=10)), "y", "x")


def test_a_subgraph_that_reads_the_image_is_reported() -> None:
    branch = "{} () => (float[N,C,H,W] {}) {{ {} = {}(x) }}"
    then, other = branch.format("t", "o1", "o1", "Relu"), branch.format("e", "o2", "o2", "Neg")
    made = model(f"y = If<then_branch = {then}, else_branch = {other}>(c)", "float[N,C,H,W] x, bool c")
    with pytest.raises(UnsupportedGraphError, match=r"If .*no rule"):
        build_adjoint(Graph(made), "y", "x")


def test_an_integer_path_beside_the_float_one_is_reported() -> None:
    body = """q = QuantizeLinear(x, s, z)  p = MaxPool<kernel_shape=[1,1]>(q)  d = DequantizeLinear(p, s, z)
              y = Add(d, x)"""
    made = model(body, opset=13, constants="float s = {0.1}, uint8 z = {0}")
    with pytest.raises(UnsupportedGraphError, match="'q' holds integers"):
        build_adjoint(Graph(made), "y", "x")


@pytest.mark.parametrize(
    "body",
    ["y = Relu(z)", "a = Floor(x)  y = Mul(a, z)", "i = Cast<to=7>(x)  f = Cast<to=1>(i)  y = Mul(f, z)"],
    ids=["another_input", "a_constant_op", "through_integers"],
)
def test_a_layer_without_the_image_is_an_error(body: str) -> None:
    graph = Graph(model(body, "float[N,C,H,W] x, float[N,C,H,W] z"))
    with pytest.raises(LayerError, match=r"'y' does not depend on 'x'"):
        build_adjoint(graph, "y", "x")


def test_registering_twice_is_an_error() -> None:
    with pytest.raises(ValueError, match="'Relu' is registered already"):
        adjoint("Relu")(lambda _ctx, _node, grad: [grad])
    with pytest.raises(ValueError, match="'Floor' is registered already"):
        adjoint("Floor")(lambda _ctx, _node, grad: [grad])
    with pytest.raises(ValueError, match="'Conv' is registered already"):
        no_gradient("Conv")


def test_constants_written_as_nodes() -> None:
    body = """s = Constant<value_float=0.25>()
              a = Constant<value_ints=[-1]>()  m = Mul(x, s)  y = Unsqueeze(m, a)"""
    graph = Graph(model(body, "float[N,C,H] x"))
    assert graph.constant("s") == 0.25
    assert graph.constant("a").tolist() == [-1]
    build_adjoint(graph, "y", "x")


def test_ops_that_only_move_numbers_keep_the_rank_known() -> None:
    body = """g = GroupNormalization<num_groups=1>(x, s, s)
              h = GroupNormalization<num_groups=2>(g, s, s)  y = Relu(h)"""
    graph = Graph(model(body, "float[N,2,H,W] x, float[2] s", opset=21))
    assert graph.rank("h") == 4
    assert graph.rank("y") == 4


def test_every_name_tells_the_forward_node() -> None:
    body = "a = Conv<kernel_shape=[3,3], strides=[2,2]>(x, w)  b = Relu(a)  y = MaxPool<kernel_shape=[3,3]>(b)"
    made = model(body, "float[N,2,H,W] x, float[2,2,3,3] w")
    graph = Graph(made)
    build_adjoint(graph, "y", "x")
    emitted = [n.name for n in graph.nodes if not n.name.startswith("node_")]
    assert {name.split("/")[1] for name in emitted} == {"node_0", "node_1", "node_2"}
    assert len(set(emitted)) == len(emitted)


def test_the_table_is_as_wide_as_documented() -> None:
    assert len(supported_ops()) >= 75
