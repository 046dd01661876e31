"""Gradients held in phases: exact in float64 for every kernel, parity and chain, and really in phases."""

from __future__ import annotations

import re
import zlib

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from elf_export.adjoint import build_adjoint
from elf_export.graph.graph import Graph, attributes
from elf_export.saliency import GRADIENT, SALIENCY, build_gradient, build_saliency
from helpers import textured

CHANNELS = 5
# Pads at the top, on the left, below, on the right, of 3x3 kernels: phases of (H + 1) // 2 rows, and of H // 2 + 1.
DOWN = {"down1": (1, 1, 1, 1), "down2": (0, 0, 1, 1)}
# As DOWN's, of convolutions whose output is of another size than their input.
OTHER_SIZE = {"conv_less": (0, 0, 0, 0), "conv_more": (2, 2, 2, 2), "conv_narrower": (1, 0, 1, 0)}


def pads_of(kind: str, kernel: np.ndarray) -> tuple[int, int, int, int]:
    h, w = kernel.shape[2:]
    return OTHER_SIZE.get(kind, ((h - 1) // 2, (w - 1) // 2, h // 2, w // 2))


def chain(layers: list[str], kernels: dict[str, np.ndarray]) -> onnx.ModelProto:
    """x (N, 3, H, W) through `layers`.

    convN (same size), OTHER_SIZE's, downN (depthwise, every 2 pixels), relu, relu6, pool, add (the value and itself).
    """
    nodes, tensors, value = [], [], "x"
    for index, kind in enumerate(layers):
        out = f"v{index}"
        if kind.startswith("conv"):
            kernel = kernels[kind]
            if kind not in {tensor.name for tensor in tensors}:
                tensors.append(numpy_helper.from_array(kernel, kind))
            nodes.append(helper.make_node("Conv", [value, kind], [out], name=out, pads=pads_of(kind, kernel)))
        elif kind.startswith("down"):
            tensors.append(numpy_helper.from_array(kernels[kind], kind))
            form = {"pads": DOWN[kind], "strides": [2, 2], "group": len(kernels[kind])}
            nodes.append(helper.make_node("Conv", [value, kind], [out], name=out, **form))
        elif kind == "relu":
            nodes.append(helper.make_node("Relu", [value], [out], name=out))
        elif kind == "relu6":
            bounds = [numpy_helper.from_array(np.float64(bound), f"{out}_{bound}") for bound in (0, 6)]
            tensors += bounds
            nodes.append(helper.make_node("Clip", [value, *(bound.name for bound in bounds)], [out], name=out))
        elif kind == "pool":
            nodes.append(helper.make_node("MaxPool", [value], [out], name=out, kernel_shape=[2, 2], strides=[2, 2]))
        else:
            nodes.append(helper.make_node("Add", [value, value], [out], name=out))
        value = out
    image = helper.make_tensor_value_info("x", TensorProto.DOUBLE, ["N", 3, "H", "W"])
    output = helper.make_tensor_value_info(value, TensorProto.DOUBLE, None)
    graph = helper.make_graph(nodes, "chain", [image], [output], tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def by_torch(layers: list[str], kernels: dict[str, np.ndarray], x: np.ndarray) -> np.ndarray:
    image = torch.tensor(x, requires_grad=True)
    value = image
    for kind in layers:
        if kind.startswith("conv"):
            top, left, bottom, right = pads_of(kind, kernels[kind])
            framed = torch.nn.functional.pad(value, [left, right, top, bottom])
            value = torch.nn.functional.conv2d(framed, torch.tensor(kernels[kind]))
        elif kind.startswith("down"):
            top, left, bottom, right = DOWN[kind]
            framed = torch.nn.functional.pad(value, [left, right, top, bottom])
            value = torch.nn.functional.conv2d(framed, torch.tensor(kernels[kind]), stride=2, groups=value.shape[1])
        elif kind == "relu":
            value = value.relu()
        elif kind == "relu6":
            value = torch.nn.functional.relu6(value)
        elif kind == "pool":
            value = torch.nn.functional.max_pool2d(value, 2)
        else:
            value = value + value
    (gradient,) = torch.autograd.grad(value, image, value.detach())
    return gradient.numpy()


def evaluated(graph: Graph, value: str, x: np.ndarray, **feed: np.ndarray) -> np.ndarray:
    """A value of the graph in float64, by ONNX's reference evaluator."""
    del graph.model.graph.output[:]
    graph.model.graph.output.append(helper.make_tensor_value_info(value, TensorProto.DOUBLE, None))
    (found,) = ReferenceEvaluator(graph.model).run(None, {"x": x, **feed})
    return np.asarray(found)


CHAINS = {
    "one pool": ["conv1", "relu", "pool"],
    "two convolutions before a pool": ["conv1", "relu", "conv2", "relu", "pool"],
    "VGG's first blocks": ["conv1", "relu", "conv2", "relu", "pool", "conv3", "relu", "conv2", "relu", "pool"],
    "three convolutions": ["conv1", "relu", "conv2", "relu", "conv3", "relu", "conv2", "relu", "pool"],
    "no relu before the pool": ["conv1", "relu", "conv2", "pool", "conv3"],
    "convolutions without a relu between": ["conv1", "conv2", "pool"],
    "pool of the image": ["pool", "conv1", "relu", "pool"],
    "a pool alone": ["pool"],
    "pool of a pool": ["conv1", "relu", "pool", "pool"],
    "relu behind a pool": ["conv1", "pool", "relu", "conv2", "relu", "pool"],
    "two uses": ["conv1", "relu", "add", "conv2", "relu", "pool"],
    "a relu twice": ["conv1", "relu", "relu", "pool"],
    "relu6 before a pool": ["conv1", "relu6", "conv2", "relu6", "pool"],
    "a mobile network's blocks": ["conv1", "relu6", "conv2", "relu", "down1", "conv3", "relu6", "down2"],
    "TensorFlow's padding": ["conv1", "relu6", "conv2", "relu6", "down2"],
    "every 2 pixels without a relu": ["conv1", "down1", "relu", "pool"],
}


KERNELS = [(3, 3), (1, 1), (5, 3), (2, 4), (1, 7)]
SIZES = [(12, 16), (13, 17), (15, 12)]


def problem(
    name: str, kernel: tuple[int, int], size: tuple[int, int]
) -> tuple[list[str], dict[str, np.ndarray], np.ndarray, int]:
    """A chain's layers, its kernels, two images (the second with ties), and the seed they were drawn by.

    All are multiples of an eighth: every forward sum is exact, in whatever order a processor takes it, and what ties
    in one evaluation ties in all.
    """
    layers = CHAINS[name]
    seed = zlib.crc32(repr((name, kernel, size)).encode())
    rng = np.random.default_rng(seed)
    kernels = {
        "conv1": eighths(rng.standard_normal((CHANNELS, 3, *kernel))),
        "conv2": eighths(rng.standard_normal((CHANNELS, CHANNELS, *kernel))),
        "conv3": eighths(rng.standard_normal((CHANNELS, CHANNELS, 3, 3))),
        **{down: eighths(rng.standard_normal((CHANNELS, 1, 3, 3))) for down in DOWN},
    }
    if layers[0] == "pool":
        kernels["conv1"] = eighths(rng.standard_normal((CHANNELS, 3, 3, 3)))
    x = eighths(textured(*size, seed=1).astype(np.float64).transpose(2, 0, 1)[None] / 50 - 2)
    x = np.concatenate([x, np.round(x[:, :, ::-1])])  # the second with ties
    x[1, :, : size[0] // 2] = 1.0
    return layers, kernels, x, seed


def eighths(values: np.ndarray) -> np.ndarray:
    return np.round(values * 8) / 8


@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("size", SIZES)
def test_exact_in_float64(name: str, kernel: tuple[int, int], size: tuple[int, int]) -> None:
    layers, kernels, x, seed = problem(name, kernel, size)
    graph = Graph(chain(layers, kernels))
    gradient = build_adjoint(graph, graph.model.graph.output[0].name, "x")
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
    found = evaluated(graph, build_adjoint(graph, graph.model.graph.output[0].name, "x"), x)
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
    assert joins == [("adj/v4/interleaved", "Reshape"), ("adj/x/interleaved", "DepthToSpace")]


@pytest.mark.parametrize("name", ["VGG's first blocks", "a mobile network's blocks"])
def test_masks_read_no_rows_that_they_do_not_need(name: str) -> None:
    """A map that has left the caches is read once for its even rows and once for its odd ones; columns likewise."""
    graph = Graph(chain(*problem(name, (3, 3), (12, 16))[:2]))
    build_adjoint(graph, graph.model.graph.output[0].name, "x")
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
    build_adjoint(graph, graph.model.graph.output[0].name, "x")
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
