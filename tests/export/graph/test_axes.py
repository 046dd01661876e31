"""Which values are maps of the image: followed through Reshape, Transpose and MatMul."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import helper

from elf_export import LayerError, build_saliency
from elf_export.command.listing import layer_table
from elf_export.graph.axes import axes_of
from elf_export.graph.cost import sizes_where_known
from elf_export.graph.graph import Graph
from export import small_models as small

SIZE = 64  # of the image; cells of 16 pixels are 16 tokens, whose attention map looks like one of stride 4


def letters(nodes: small.Nodes, tensors: dict[str, np.ndarray], output: str, layout: str = "NCHW") -> dict[str, str]:
    shape = [{"N": 1, "C": 3, "H": SIZE, "W": SIZE}[axis] for axis in layout]
    graph = Graph(small.model(nodes, tensors, shape, output))
    return axes_of(graph, "x", layout, sizes_where_known(graph))


def reshape(source: str, output: str, *sizes: int) -> tuple[onnx.NodeProto, dict[str, np.ndarray]]:
    return helper.make_node("Reshape", [source, f"{output}/to"], [output]), {f"{output}/to": np.array(sizes, np.int64)}


def chain(*steps: tuple[onnx.NodeProto, dict[str, np.ndarray]] | onnx.NodeProto) -> tuple[small.Nodes, dict]:
    nodes: small.Nodes = []
    tensors: dict[str, np.ndarray] = {}
    for step in steps:
        node, constants = (step, {}) if isinstance(step, onnx.NodeProto) else step
        nodes.append(node)
        tensors |= constants
    return nodes, tensors


def transpose(source: str, output: str, *perm: int) -> onnx.NodeProto:
    return helper.make_node("Transpose", [source], [output], perm=perm)


def patches(cell: int = 16) -> tuple[onnx.NodeProto, dict[str, np.ndarray]]:
    """map (1, 8, 4, 4)"""
    node = helper.make_node("Conv", ["x", "w"], ["map"], strides=[cell, cell])
    return node, {"w": small.weights(8, 3, cell, cell)}


def test_group_normalisation_gives_the_map_back() -> None:
    scale = {"s": np.ones(4, np.float32), "b": np.zeros(4, np.float32)}
    nodes = chain(
        patches(),
        reshape("map", "groups", 0, 4, -1),
        (helper.make_node("InstanceNormalization", ["groups", "s", "b"], ["normal"]), scale),
        reshape("normal", "y", 1, 8, 4, 4),
    )
    assert letters(*nodes, "y") == {"x": "NCHW", "map": "NCHW", "y": "NCHW"}


def test_channels_are_shuffled() -> None:
    nodes = chain(
        patches(), reshape("map", "apart", 1, 2, 4, 4, 4), transpose("apart", "mixed", 0, 2, 1, 3, 4),
        reshape("mixed", "y", 1, 8, 4, 4),
    )  # fmt: skip
    assert letters(*nodes, "y")["y"] == "NCHW"


@pytest.mark.parametrize("layout", ["NCHW", "NHWC"])
def test_pixels_of_a_cell_become_channels_and_pixels_again(layout: str) -> None:
    """Pixel-unshuffle and -shuffle, written in Reshape and Transpose."""
    front = [] if layout == "NCHW" else [transpose("x", "t", 0, 3, 1, 2)]
    nodes = chain(
        *front,
        reshape("x" if layout == "NCHW" else "t", "a", 1, 3, 32, 2, 32, 2),
        transpose("a", "b", 0, 1, 3, 5, 2, 4),
        reshape("b", "half", 1, 12, 32, 32),
        reshape("half", "c", 1, 3, 2, 2, 32, 32),
        transpose("c", "d", 0, 1, 4, 2, 5, 3),
        reshape("d", "y", 1, 3, 64, 64),
    )
    found = letters(*nodes, "y", layout)
    assert found["half"] == found["y"] == "NCHW"
    assert found["x"] == layout


def attention() -> tuple[small.Nodes, dict[str, np.ndarray]]:
    """16 tokens, two heads; scores (1, 2, 16, 16), heads (1, 2, 16, 4), and the map y again."""
    return chain(
        patches(),
        reshape("map", "flat", 1, 8, 16),
        transpose("flat", "tokens", 0, 2, 1),
        (helper.make_node("MatMul", ["tokens", "wq"], ["query"]), {"wq": small.weights(8, 8)}),
        reshape("query", "q", 1, 16, 2, 4),
        transpose("q", "qh", 0, 2, 1, 3),
        transpose("q", "kh", 0, 2, 3, 1),
        helper.make_node("MatMul", ["qh", "kh"], ["scores"]),
        helper.make_node("Softmax", ["scores"], ["weights"]),
        helper.make_node("MatMul", ["weights", "qh"], ["heads"]),
        transpose("heads", "back", 0, 2, 1, 3),
        reshape("back", "values", 1, 16, 8),
        helper.make_node("Add", ["tokens", "values"], ["sum"]),
        transpose("sum", "first", 0, 2, 1),
        reshape("first", "y", 1, 8, 4, 4),
    )


def test_tokens_become_a_map_again_and_an_attention_map_is_none() -> None:
    assert letters(*attention(), "y") == {"x": "NCHW", "map": "NCHW", "y": "NCHW"}
    model = small.model(*attention(), (1, 3, SIZE, SIZE), "y")
    for wrong in ("weights", "heads", "sum"):
        with pytest.raises(LayerError, match=f"'{wrong}' can't describe keypoints: it is no map"):
            build_saliency(model, "y", [wrong], "x")


def test_a_class_token_comes_and_goes() -> None:
    nodes = chain(
        patches(),
        reshape("map", "flat", 1, 8, 16),
        (
            helper.make_node("Concat", ["class", "flat"], ["more"], axis=2),
            {"class": np.ones((1, 8, 1), np.float32)},
        ),
        (
            helper.make_node("Slice", ["more", "begin", "end", "axis"], ["less"]),
            {"begin": np.array([1]), "end": np.array([17]), "axis": np.array([2])},
        ),
        reshape("less", "y", 1, 8, 4, 4),
    )
    assert letters(*nodes, "y")["y"] == "NCHW"


def test_windows_that_the_image_is_cut_into_are_no_map_until_they_are_put_together() -> None:
    nodes = chain(
        transpose("x", "last", 0, 2, 3, 1),
        reshape("last", "a", 1, 8, 8, 8, 8, 3),
        transpose("a", "b", 0, 1, 3, 2, 4, 5),
        reshape("b", "windows", 64, 8, 8, 3),
        reshape("windows", "c", 1, 8, 8, 8, 8, 3),
        transpose("c", "d", 0, 1, 3, 2, 4, 5),
        reshape("d", "y", 1, 64, 64, 3),
    )
    assert letters(*nodes, "y") == {"x": "NCHW", "last": "NHWC", "y": "NHWC"}


def test_a_convolution_makes_a_map_of_what_could_not_be_followed() -> None:
    nodes = chain(
        helper.make_node("Einsum", ["x"], ["lost"], equation="nchw->nchw"),
        (helper.make_node("Conv", ["lost", "w"], ["map"]), {"w": small.weights(8, 3, 3, 3)}),
        helper.make_node("Relu", ["map"], ["y"]),
    )
    assert letters(*nodes, "y") == {"x": "NCHW", "map": "NCHW", "y": "NCHW"}


def test_a_squeeze_and_excitation_gate_leaves_the_map_what_it_is() -> None:
    nodes = chain(
        patches(),
        helper.make_node("GlobalAveragePool", ["map"], ["mean"]),
        reshape("mean", "vector", 1, 8),
        (helper.make_node("Gemm", ["vector", "wg"], ["gates"], transB=1), {"wg": small.weights(8, 8)}),
        reshape("gates", "gate", 1, 8, 1, 1),
        helper.make_node("Shape", ["map"], ["size"]),
        helper.make_node("Expand", ["gate", "size"], ["wide"]),
        helper.make_node("Mul", ["map", "wide"], ["y"]),
    )
    assert letters(*nodes, "y")["y"] == "NCHW"


def test_the_sum_of_a_map_and_its_transpose_is_none() -> None:
    nodes = chain(patches(), transpose("map", "turned", 0, 1, 3, 2), helper.make_node("Add", ["map", "turned"], ["y"]))
    found = letters(*nodes, "y")
    assert found["turned"] == "NCWH"
    assert "y" not in found


def group_normalised() -> onnx.ModelProto:
    """Of any size: Conv, GroupNorm as older opsets write it, Relu, Conv."""
    scale = {"s": np.ones(4, np.float32), "b": np.zeros(4, np.float32)}
    nodes = chain(
        patches(4),
        reshape("map", "groups", 0, 4, -1),
        (helper.make_node("InstanceNormalization", ["groups", "s", "b"], ["normal"]), scale),
        helper.make_node("Shape", ["map"], ["size"]),
        helper.make_node("Cast", ["size"], ["floats"], to=onnx.TensorProto.FLOAT),
        helper.make_node("Cast", ["floats"], ["sizes"], to=onnx.TensorProto.INT64),
        helper.make_node("Reshape", ["normal", "sizes"], ["again"]),
        helper.make_node("Relu", ["again"], ["relu"]),
        (helper.make_node("Conv", ["relu", "w2"], ["y"]), {"w2": small.weights(6, 8, 2, 2)}),
    )
    return small.model(*nodes, ("N", 3, "H", "W"), "y")


def test_layers_behind_group_normalisation_are_listed_with_their_sizes() -> None:
    rows = {line.split()[0]: line.split()[1:5] for line in layer_table(group_normalised(), "x").splitlines()}
    assert rows["relu"] == ["Relu", "8", "128x128", "4"]
    assert rows["y"] == ["Conv", "6", "127x127", "4"]


@pytest.mark.parametrize(("layer", "channels"), [("relu", 8), ("y", 6)])
def test_layers_behind_group_normalisation_describe(layer: str, channels: int) -> None:
    saliency = build_saliency(group_normalised(), "map", [layer], "x")
    assert saliency.graph.output[1].type.tensor_type.shape.dim[3].dim_value == channels
