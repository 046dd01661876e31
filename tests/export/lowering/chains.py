"""Chains of layers in front of an image, with their gradient by torch."""

from __future__ import annotations

import zlib

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from elf_export.graph.graph import Graph
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
