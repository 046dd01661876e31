"""Small ONNX models as other frameworks write them: seeded, with helpers of onnx alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper, parser

Nodes = list[onnx.NodeProto]


def weights(*shape: int, seed: int = 0) -> np.ndarray:
    fan_in = int(np.prod(shape[1:])) or 1
    return (np.random.default_rng(seed).standard_normal(shape) / np.sqrt(fan_in)).astype(np.float32)


def model(
    nodes: Nodes,
    tensors: dict[str, np.ndarray],
    shape: Sequence[int | str],
    output: str,
    opset: int = 17,
    elem: int = TensorProto.FLOAT,
    ir_version: int = 8,
) -> onnx.ModelProto:
    """A model of one input ``x`` and one output."""
    kind = TensorProto.FLOAT if elem == TensorProto.UINT8 else elem
    graph = helper.make_graph(
        nodes, "small", [helper.make_tensor_value_info("x", elem, shape)],
        [helper.make_tensor_value_info(output, kind, None)],
        [numpy_helper.from_array(value, name) for name, value in tensors.items()],
    )  # fmt: skip
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=ir_version)


def written(body: str, tensors: dict[str, np.ndarray], shape: Sequence[int | str]) -> onnx.ModelProto:
    """x to y, in ONNX's textual form; nodes have the names of their results."""
    nodes = list(parser.parse_graph(f"g (float x) => (float y) {{ {body} }}").node)
    for node in nodes:
        node.name = node.output[0]
    return model(nodes, tensors, shape, "y")


def convolutions(source: str = "x", channels: int = 3) -> tuple[Nodes, dict[str, np.ndarray]]:
    """conv1 - relu1 - pool1 - conv2 - relu2, of NCHW."""
    nodes = [
        helper.make_node("Conv", [source, "w1", "b1"], ["conv1"], name="block/conv1", pads=[1] * 4),
        helper.make_node("Relu", ["conv1"], ["relu1"], name="block/relu1"),
        helper.make_node("MaxPool", ["relu1"], ["pool1"], name="pool1", kernel_shape=[2, 2], strides=[2, 2]),
        helper.make_node("Conv", ["pool1", "w2"], ["conv2"], name="head/conv2", pads=[1] * 4),
        helper.make_node("Relu", ["conv2"], ["relu2"], name="head/relu2"),
    ]
    tensors = {"w1": weights(6, channels, 3, 3), "b1": weights(6, seed=1), "w2": weights(4, 6, 3, 3, seed=2)}
    return nodes, tensors


def nchw(size: Sequence[int | str] = (1, 3, 64, 64), opset: int = 17) -> onnx.ModelProto:
    nodes, tensors = convolutions(channels=int(size[1]))
    return model(nodes, tensors, size, "relu2", opset)


def nhwc(size: Sequence[int | str] = (1, 64, 64, 3), back: bool = True) -> onnx.ModelProto:
    """As TensorFlow's converters write it: a Transpose first, and one behind the last map."""
    nodes, tensors = convolutions("t")
    nodes.insert(0, helper.make_node("Transpose", ["x"], ["t"], name="to_nchw", perm=[0, 3, 1, 2]))
    if back:
        nodes.append(helper.make_node("Transpose", ["relu2"], ["y"], name="to_nhwc", perm=[0, 2, 3, 1]))
    return model(nodes, tensors, size, "y" if back else "relu2")


def classifier(classes: int = 5) -> onnx.ModelProto:
    """The convolutions, flattened into a fully connected layer: its size can't be freed."""
    nodes, tensors = convolutions()
    nodes += [
        helper.make_node("Flatten", ["relu2"], ["flat"], name="flat"),
        helper.make_node("Gemm", ["flat", "w3"], ["logits"], name="logits", transB=1),
    ]
    tensors["w3"] = weights(classes, 4 * 20 * 24, seed=3)
    return model(nodes, tensors, ("N", 3, 40, 48), "logits")


def tokens() -> onnx.ModelProto:
    """pool1 as a sequence of 480 cells, which fixes the image to 48x40 pixels."""
    nodes, tensors = convolutions()
    nodes = [*nodes[:3], helper.make_node("Reshape", ["pool1", "shape"], ["tokens"], name="tokens")]
    tensors = {"w1": tensors["w1"], "b1": tensors["b1"], "shape": np.array([-1, 6, 480], np.int64)}
    return model(nodes, tensors, ("N", 3, 40, 48), "tokens")


def half_precision() -> onnx.ModelProto:
    nodes, tensors = convolutions()
    halves = {name: value.astype(np.float16) for name, value in tensors.items()}
    return model(nodes, halves, (1, 3, 64, 64), "relu2", elem=TensorProto.FLOAT16)


def bytes_in() -> onnx.ModelProto:
    """uint8 pixels, NHWC, cast inside."""
    nodes, tensors = convolutions("t")
    front = [
        helper.make_node("Cast", ["x"], ["float"], name="cast", to=TensorProto.FLOAT),
        helper.make_node("Transpose", ["float"], ["t"], name="to_nchw", perm=[0, 3, 1, 2]),
    ]
    return model(front + nodes, tensors, ("N", "H", "W", 3), "relu2", elem=TensorProto.UINT8)


def pyramid() -> onnx.ModelProto:
    """Two strides of 2, enlarged and added back: it runs on multiples of 4 only."""
    nodes = [
        helper.make_node("Conv", ["x", "w1"], ["half"], name="half", pads=[1] * 4, strides=[2, 2]),
        helper.make_node("Conv", ["half", "w2"], ["quarter"], name="quarter", pads=[1] * 4, strides=[2, 2]),
        helper.make_node("Resize", ["quarter", "", "scales"], ["large"], name="large", mode="nearest",
                         coordinate_transformation_mode="asymmetric", nearest_mode="floor"),
        helper.make_node("Add", ["half", "large"], ["sum"], name="sum"),
        helper.make_node("Relu", ["sum"], ["y"], name="y"),
    ]  # fmt: skip
    tensors = {
        "w1": weights(6, 3, 3, 3),
        "w2": weights(6, 6, 3, 3, seed=1),
        "scales": np.array([1, 1, 2, 2], np.float32),
    }
    return model(nodes, tensors, (1, 3, 64, 64), "y")


def convnext() -> onnx.ModelProto:
    """A stem of 4x4 pixels and a block of depthwise 7x7, two linear layers channels last and a residual, as y."""
    nodes = [
        helper.make_node("Conv", ["x", "w1"], ["stem"], name="stem", strides=[4, 4]),
        helper.make_node("Conv", ["stem", "w2"], ["wide"], name="wide", pads=[3] * 4, group=8),
        helper.make_node("Transpose", ["wide"], ["last"], name="last", perm=[0, 2, 3, 1]),
        helper.make_node("MatMul", ["last", "w3"], ["more"], name="more"),
        helper.make_node("Sigmoid", ["more"], ["gate"], name="gate"),
        helper.make_node("Mul", ["more", "gate"], ["silu"], name="silu"),
        helper.make_node("MatMul", ["silu", "w4"], ["fewer"], name="fewer"),
        helper.make_node("Transpose", ["fewer"], ["first"], name="first", perm=[0, 3, 1, 2]),
        helper.make_node("Add", ["stem", "first"], ["y"], name="y"),
    ]
    shapes = {"w1": (8, 3, 4, 4), "w2": (8, 1, 7, 7), "w3": (8, 16), "w4": (16, 8)}
    tensors = {name: weights(*shape, seed=i) for i, (name, shape) in enumerate(shapes.items())}
    return model(nodes, tensors, ("N", 3, "H", "W"), "y")


def unet(levels: int, transposed: bool = False, size: Sequence[int | str] = ("N", 3, "H", "W")) -> onnx.ModelProto:
    """Convolutions and pools down, and up again beside what was kept: up0 is as large as the image, up1 half ..."""
    nodes: Nodes = []
    tensors = {"scales": np.array([1, 1, 2, 2], np.float32)}
    x, channels = "x", 3
    for i in range(levels):
        tensors[f"w{i}"] = weights(4, channels, 3, 3, seed=i)
        nodes += [
            helper.make_node("Conv", [x, f"w{i}"], [f"conv{i}"], name=f"conv{i}", pads=[1] * 4),
            helper.make_node("Relu", [f"conv{i}"], [f"kept{i}"], name=f"kept{i}"),
            helper.make_node("MaxPool", [f"kept{i}"], [f"down{i}"], name=f"down{i}", kernel_shape=[2, 2],
                             strides=[2, 2]),
        ]  # fmt: skip
        x, channels = f"down{i}", 4
    for i in reversed(range(levels)):
        if transposed:
            tensors[f"t{i}"] = weights(4, 4, 2, 2, seed=20 + i)
            large = helper.make_node("ConvTranspose", [x, f"t{i}"], [f"large{i}"], name=f"large{i}", strides=[2, 2])
        else:
            large = helper.make_node("Resize", [x, "", "scales"], [f"large{i}"], name=f"large{i}", mode="nearest",
                                     coordinate_transformation_mode="asymmetric", nearest_mode="floor")  # fmt: skip
        tensors[f"v{i}"] = weights(4, 8, 3, 3, seed=10 + i)
        nodes += [
            large,
            helper.make_node("Concat", [f"large{i}", f"kept{i}"], [f"both{i}"], name=f"both{i}", axis=1),
            helper.make_node("Conv", [f"both{i}", f"v{i}"], [f"mixed{i}"], name=f"mixed{i}", pads=[1] * 4),
            helper.make_node("Relu", [f"mixed{i}"], [f"up{i}"], name=f"up{i}"),
        ]
        x = f"up{i}"
    return model(nodes, tensors, size, x)


def windows(cells: int, patch: int = 4, size: Sequence[int | str] = ("N", 3, "H", "W")) -> onnx.ModelProto:
    """As Swin: patches, cut into windows of cells x cells, mixed by a softmax within each, and put together to y."""
    numbers = {"zero": 0, "one": 1, "two": 2, "side": cells, "area": cells * cells, "channels": 8, "rest": -1}
    tensors = {name: np.array([value]) for name, value in numbers.items()}
    tensors |= {"w": weights(8, 3, patch, patch), "m": weights(8, 8, seed=1)}
    body = """embedded = Conv(x, w)
        last = Transpose<perm=[0,2,3,1]>(embedded)  sizes = Shape(last)
        n = Gather<axis=0>(sizes, zero)  h = Gather<axis=0>(sizes, one)  v = Gather<axis=0>(sizes, two)
        down = Div(h, side)  across = Div(v, side)
        split_shape = Concat<axis=0>(n, down, side, across, side, channels)  split = Reshape(last, split_shape)
        turned = Transpose<perm=[0,1,3,2,4,5]>(split)
        window_shape = Concat<axis=0>(rest, area, channels)  tokens = Reshape(turned, window_shape)
        products = MatMul(tokens, m)  mixed = Softmax<axis=1>(products)
        back_shape = Concat<axis=0>(n, down, across, side, side, channels)  back = Reshape(mixed, back_shape)
        rows = Transpose<perm=[0,1,3,2,4,5]>(back)  map = Reshape(rows, sizes)
        y = Transpose<perm=[0,3,1,2]>(map)"""
    result = written(body, tensors, size)
    result.graph.node[0].attribute.append(helper.make_attribute("strides", [patch, patch]))
    return result
