"""Two convolutions as one: exact everywhere, and left alone where it would not be or would not pay."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from elf_export.graph.cost import fix_sizes
from elf_export.graph.graph import Graph, GraphView
from elf_export.graph.passes import compose_convs


def chain(
    kernels: tuple[int, int],
    pads: tuple[list[int], list[int]],
    channels: tuple[int, int, int],
    **first: object,
) -> onnx.ModelProto:
    """x -> Conv -> Conv -> Abs, in float64, with seeded kernels and biases."""
    rng = np.random.default_rng(3)
    (kw, kv), (inputs, middle, outputs) = kernels, channels
    tensors = {
        "w": (middle, inputs, kw, kw), "b": (middle,), "v": (outputs, middle, kv, kv), "c": (outputs,),
    }  # fmt: skip
    values = [numpy_helper.from_array(rng.standard_normal(shape), name) for name, shape in tensors.items()]
    nodes = [
        helper.make_node("Conv", ["x", "w", "b"], ["m"], name="one", pads=pads[0], **first),
        helper.make_node("Conv", ["m", "v", "c"], ["z"], name="two", pads=pads[1]),
        helper.make_node("Abs", ["z"], ["y"], name="abs"),
    ]
    x = helper.make_tensor_value_info("x", onnx.TensorProto.DOUBLE, ["N", inputs, "H", "W"])
    y = helper.make_tensor_value_info("y", onnx.TensorProto.DOUBLE, ["N", outputs, "h", "w"])
    graph = helper.make_graph(nodes, "g", [x], [y], values)
    return helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)])


CASES = [
    ((3, 3), ([1] * 4, [1] * 4), (1, 16, 1)),
    ((3, 3), ([0] * 4, [2] * 4), (2, 16, 2)),
    ((5, 3), ([2, 1, 2, 3], [1] * 4), (1, 8, 2)),
    ((3, 3), ([2, 2, 0, 0], [0, 0, 2, 2]), (1, 16, 1)),
    ((3, 1), ([1] * 4, [0] * 4), (1, 8, 1)),
    ((2, 2), ([1, 1, 0, 0], [0, 0, 1, 1]), (3, 32, 3)),
]


@pytest.mark.parametrize(("kernels", "pads", "channels"), CASES)
@pytest.mark.parametrize("size", [(9, 11), (8, 7), (32, 33)])
def test_the_composition_is_exact_up_to_the_border(
    kernels: tuple[int, int],
    pads: tuple[list[int], list[int]],
    channels: tuple[int, int, int],
    size: tuple[int, int],
) -> None:
    model = chain(kernels, pads, channels)
    composed = compose_convs(Graph(model)).model
    onnx.checker.check_model(composed, full_check=True)
    assert any(node.name == "two/composed/inside" for node in composed.graph.node)
    x = np.random.default_rng(4).standard_normal((2, channels[0], *size))
    (wanted,), (found,) = (ReferenceEvaluator(m).run(None, {"x": x}) for m in (model, composed))
    np.testing.assert_allclose(found, wanted, atol=1e-11)


def test_one_kernel_over_the_whole_image_would_be_wrong_at_the_border() -> None:
    """Why the strips are there: the same composed kernel with zero padding is off in the outermost ring."""
    model = chain((3, 3), ([1] * 4, [1] * 4), (1, 16, 1))
    composed = compose_convs(Graph(model)).model
    tensors = {t.name: numpy_helper.to_array(t) for t in composed.graph.initializer}
    kernel, bias = tensors["two/composed/kernel"][0, 0], tensors["two/composed/bias"][0]
    x = np.random.default_rng(4).standard_normal((1, 1, 12, 13))
    (wanted,) = ReferenceEvaluator(model).run(None, {"x": x})
    padded = np.pad(x[0, 0], 2)
    windows = np.lib.stride_tricks.sliding_window_view(padded, kernel.shape)
    naive = np.abs(np.einsum("ijkl,kl->ij", windows, kernel) + bias)
    wrong = np.abs(naive - wanted[0, 0]) > 1e-9
    assert wrong[0].any()
    assert wrong[:, -1].any()
    assert not wrong[1:-1, 1:-1].any()


@pytest.mark.parametrize(
    "model",
    [
        chain((3, 3), ([1] * 4, [1] * 4), (8, 8, 8)),  # more arithmetic than before
        chain((3, 3), ([1] * 4, [1] * 4), (1, 16, 1), strides=[2, 2]),
        chain((3, 3), ([2] * 4, [1] * 4), (1, 16, 1), dilations=[2, 2]),
        chain((3, 3), ([0] * 4, [1] * 4), (1, 16, 1)),  # shrinks the image
    ],
)
def test_left_alone(model: onnx.ModelProto) -> None:
    assert [node.name for node in compose_convs(Graph(model)).nodes] == ["one", "two", "abs"]


def test_a_middle_value_that_is_wanted_stays() -> None:
    model = chain((3, 3), ([1] * 4, [1] * 4), (1, 16, 1))
    assert [node.name for node in compose_convs(Graph(model), keep=["m"]).nodes] == ["one", "two", "abs"]
    middle = helper.make_tensor_value_info("m", onnx.TensorProto.DOUBLE, ["N", 16, "h", "w"])
    model.graph.output.append(middle)
    assert [node.name for node in compose_convs(Graph(model)).nodes] == ["one", "two", "abs"]


@pytest.mark.parametrize(("least", "composed"), [(4, False), (5, True)])
def test_the_smallest_map_must_hold_the_composed_kernel(least: int, composed: bool) -> None:
    """The inside is a convolution without padding: ONNX Runtime runs none on a map smaller than its kernel."""
    model, smallest = (chain((3, 3), ([1] * 4, [1] * 4), (1, 16, 1)) for _ in range(2))
    fix_sizes(smallest, "x", "NCHW", least)
    found = compose_convs(Graph(model), smallest=GraphView(smallest)).model
    assert any(node.name == "two/composed/inside" for node in found.graph.node) == composed
    x = np.random.default_rng(4).standard_normal((1, 1, least, least))
    (wanted,), (values,) = (ReferenceEvaluator(m).run(None, {"x": x}) for m in (model, found))
    np.testing.assert_allclose(values, wanted, atol=1e-11)


@pytest.mark.parametrize(
    ("channels", "sizes"), [((3, 32, 8, 16), (1, 1, 1)), ((3, 64, 16, 8), (1, 3, 1)), ((3, 64, 3, 64, 3), (3, 3, 3, 3))]
)
def test_several_convolutions_in_a_row(channels: tuple[int, ...], sizes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(3)
    shapes = [(o, i, k, k) for i, o, k in zip(channels[:-1], channels[1:], sizes, strict=True)]
    kernels = [numpy_helper.from_array(rng.standard_normal(shape), f"w{i}") for i, shape in enumerate(shapes)]
    nodes = [
        helper.make_node("Conv", [f"v{i}", f"w{i}"], [f"v{i + 1}"], name=f"c{i}", pads=[k // 2] * 4)
        for i, k in enumerate(sizes)
    ]
    infos = [
        helper.make_tensor_value_info(f"v{i}", onnx.TensorProto.DOUBLE, ["N", channels[i], None, None])
        for i in (0, len(sizes))
    ]
    graph = helper.make_graph(nodes, "g", infos[:1], infos[1:], kernels)
    model = helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)])
    composed = compose_convs(Graph(model)).model
    onnx.checker.check_model(composed, full_check=True)
    assert any(node.name.endswith("/composed/inside") for node in composed.graph.node)
    x = rng.standard_normal((1, channels[0], 9, 11))
    (wanted,), (found,) = (ReferenceEvaluator(m).run(None, {"v0": x}) for m in (model, composed))
    np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-10 * np.abs(wanted).max())
