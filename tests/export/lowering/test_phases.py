"""Gradients held in phases: exact in float64 for every kernel, parity and chain, and really in phases."""

from __future__ import annotations

import re

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from elf_export.dialect import OWN
from elf_export.graph.graph import Graph, attributes
from elf_export.lowering import TARGETS, lower, write_steps
from elf_export.saliency import GRADIENT, SALIENCY, build_gradient, build_saliency
from export.adjoint.runs import differentiated

from .chains import CHAINS, CHANNELS, KERNELS, OTHER_SIZE, SIZES, by_torch, chain, eighths, evaluated, problem


@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("size", SIZES)
def test_exact_in_float64(name: str, kernel: tuple[int, int], size: tuple[int, int]) -> None:
    layers, kernels, x, seed = problem(name, kernel, size)
    graph = Graph(chain(layers, kernels))
    gradient = differentiated(graph, graph.model.graph.output[0].name, "x")
    assert any(node.name.endswith("/dx_00") for node in graph.nodes)  # in phases
    found = evaluated(graph, gradient, x)
    wanted = by_torch(layers, kernels, x)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() <= 1e-10 * np.abs(wanted).max(), f"seed {seed}"


@pytest.mark.parametrize("kind", OTHER_SIZE)
def test_convolutions_that_change_the_size(kind: str) -> None:
    rng = np.random.default_rng(0)
    kernels = {name: eighths(rng.standard_normal((CHANNELS, c, 3, 3))) for name, c in (("conv1", 3), (kind, CHANNELS))}
    layers, x = ["conv1", kind, "pool"], eighths(rng.standard_normal((1, 3, 13, 16)))
    graph = Graph(chain(layers, kernels))
    found = evaluated(graph, differentiated(graph, graph.model.graph.output[0].name, "x"), x)
    wanted = by_torch(layers, kernels, x)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() <= 1e-10 * np.abs(wanted).max()


@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("size", SIZES)
def test_the_saliency_of_phases(name: str, size: tuple[int, int]) -> None:
    """The mean over the channels, taken in phases or, of a pool of the image itself, of the whole gradient."""
    layers, kernels, x, seed = problem(name, (3, 3), size)
    model = chain(layers, kernels)
    graph = Graph(build_saliency(model, model.graph.output[0].name))
    found, wanted = evaluated(graph, SALIENCY, x), np.abs(by_torch(layers, kernels, x)).mean(axis=1)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() <= 1e-10 * wanted.max(), f"seed {seed}"


def test_a_chain_to_the_image_is_put_together_only_there(vgg_like: Graph) -> None:
    """Between a pool and the image nothing is interleaved; only the three-channel gradient is."""
    joins = [(node.name, node.op_type) for node in vgg_like.nodes if node.name.endswith("/interleaved")]
    assert joins == [("adj/v5/interleaved", "Reshape"), ("adj/v0/interleaved", "DepthToSpace")]


def test_what_was_put_together_goes_back_into_the_blocked_layout_before_it_is_masked() -> None:
    """Between two pools, behind a ReLU: else ONNX Runtime reorders all that follows."""
    rng = np.random.default_rng(0)
    kernels = {f"conv{i}": rng.standard_normal((CHANNELS, 3 if i == 1 else CHANNELS, 3, 3)) for i in (1, 2)}
    graph = Graph(chain(["conv1", "relu", "pool", "conv2", "relu", "pool"], kernels))
    differentiated(graph, graph.model.graph.output[0].name, "x")
    (back,) = [node for node in graph.nodes if node.name.endswith("/dy_blocked")]
    (mask,) = graph.consumers()[back.output[0]]
    assert graph.producers()[back.input[0]].op_type == "Transpose"
    assert (mask.op_type, mask.name) == ("Mul", "adj/v2/dy_positive")


def test_a_sum_over_windows_without_a_scale_or_with_a_computed_one() -> None:
    """Of 2x2 windows, which have a form of their own for a constant scale only."""
    x, dy, scale = (np.random.default_rng(0).standard_normal(shape) for shape in ((1, 3, 6, 8), (1, 3, 3, 4), ()))
    for given in ("", "s"):
        values = {"x": x, "d": dy, "s": scale}
        infos = [helper.make_tensor_value_info(name, TensorProto.DOUBLE, v.shape) for name, v in values.items()]
        out = helper.make_tensor_value_info("y", TensorProto.DOUBLE, x.shape)
        node = helper.make_node("WindowSum", ["d", given, "x"], ["y"], name="adj/y/dx", domain=OWN,
                                kernel_shape=[2, 2], strides=[2, 2])  # fmt: skip
        model = helper.make_model(helper.make_graph([node], "g", infos, [out]), ir_version=8,
                                  opset_imports=[helper.make_opsetid("", 17)])  # fmt: skip
        wanted = dy.repeat(2, 2).repeat(2, 3) * (scale if given else 1)
        for target in TARGETS:
            graph = write_steps(lower(Graph(model), target), target)
            np.testing.assert_allclose(evaluated(graph, "y", x, d=dy, s=scale), wanted)


@pytest.mark.parametrize("name", ["VGG's first blocks", "a mobile network's blocks"])
def test_masks_read_no_rows_that_they_do_not_need(name: str) -> None:
    """A map that has left the caches is read once for its even rows and once for its odd ones; columns likewise."""
    graph = Graph(chain(*problem(name, (3, 3), (12, 16))[:2]))
    differentiated(graph, graph.model.graph.output[0].name, "x")
    masks = [node for node in graph.nodes if re.search(r"(mask_\d\d|right_wins_\w+)_difference$", node.name)]
    assert len(masks) >= 8
    for node in masks:
        given = attributes(node)
        for axis in (0,) if "right_wins" in node.name else (0, 1):
            assert given["kernel_shape"][axis] == 1 or given["dilations"][axis] == given["strides"][axis] == 2


def test_the_four_phases_share_their_weights(vgg_like: Graph) -> None:
    """As many values as the flipped kernels themselves, apart from the image's joint convolution."""
    sizes = {t.name: int(np.prod(t.dims)) for t in vgg_like.model.graph.initializer}
    conv2 = sum(size for name, size in sizes.items() if "weight_" in name and name.startswith("adj/v2/"))
    assert conv2 == CHANNELS * CHANNELS * 9


@pytest.fixture
def vgg_like() -> Graph:
    rng = np.random.default_rng(0)
    kernels = {f"conv{i}": rng.standard_normal((CHANNELS, 3 if i == 1 else CHANNELS, 3, 3)) for i in (1, 2, 3)}
    graph = Graph(chain(CHAINS["VGG's first blocks"], kernels))
    differentiated(graph, graph.model.graph.output[0].name, "x")
    return graph


def unknown_channels(inside: bool) -> onnx.ModelProto:
    """conv - relu - pool of an image of "C" channels; or conv - relu - conv - relu - pool with a Reshape behind the
    first conv, to a shape that the run computes: its channels are unknown."""
    rng = np.random.default_rng(0)
    tensors = {"w1": rng.standard_normal((CHANNELS, 3, 3, 3)), "w2": rng.standard_normal((CHANNELS, CHANNELS, 3, 3))}
    tensors |= {name: np.array([v]) for name, v in (("two", 2), ("four", 4), ("zero", 0), ("rest", -1))}
    nodes = [helper.make_node("Conv", ["x", "w1"], ["a"], name="a", pads=[1] * 4)]
    if inside:
        nodes += [
            helper.make_node("Shape", ["a"], ["shape"], name="shape"),
            helper.make_node("Slice", ["shape", "two", "four", "zero"], ["size"], name="size"),
            helper.make_node("Concat", ["zero", "rest", "size"], ["target"], name="target", axis=0),
            helper.make_node("Reshape", ["a", "target"], ["b"], name="b"),
            helper.make_node("Relu", ["b"], ["c"], name="c"),
            helper.make_node("Conv", ["c", "w2"], ["d"], name="d", pads=[1] * 4),
        ]
    nodes += [
        helper.make_node("Relu", [nodes[-1].output[0]], ["r"], name="r"),
        helper.make_node("MaxPool", ["r"], ["y"], name="y", kernel_shape=[2, 2], strides=[2, 2]),
    ]
    image = helper.make_tensor_value_info("x", TensorProto.DOUBLE, ["N", 3 if inside else "C", "H", "W"])
    output = helper.make_tensor_value_info("y", TensorProto.DOUBLE, None)
    arrays = [numpy_helper.from_array(value, name) for name, value in tensors.items()]
    graph = helper.make_graph(nodes, "g", [image], [output], arrays)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


@pytest.mark.parametrize("inside", [False, True])
def test_unknown_channels_end_the_phases(inside: bool) -> None:
    model, x = unknown_channels(inside), np.random.default_rng(1).standard_normal((2, 3, 9, 12))
    kernels = {f"conv{i}": numpy_helper.to_array(model.graph.initializer[i - 1]) for i in (1, 2)}
    layers = ["conv1", "relu", *(["conv2", "relu"] if inside else []), "pool"]
    wanted = by_torch(layers, kernels, x)
    graph = Graph(build_saliency(model, "y", image_input="x"))
    assert any(node.name.endswith("/dx_00") for node in graph.nodes)
    np.testing.assert_allclose(evaluated(graph, SALIENCY, x), np.abs(wanted).mean(axis=1), rtol=0, atol=1e-10)
    graph = Graph(build_gradient(model, "y", "x"))
    np.testing.assert_allclose(evaluated(graph, GRADIENT, x), wanted, rtol=0, atol=1e-10)
