"""Regions of a graph that lose by 8 bits are found, and stay in floats."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from elf_export import ExportError
from elf_export.calibration import calibration_set
from elf_export.graph.graph import Graph, GraphView
from elf_export.lowering import lower
from elf_export.precision.int8 import quantize
from elf_export.precision.int8.candidates import candidates
from elf_export.precision.int8.rewrite import rewrite
from elf_export.precision.int8.scheme import Scheme
from elf_export.precision.int8.speedup import losing
from elf_runtime import InputSpec
from export import small_models as small

from .rounded_networks import images, schemes_of

Chain = list[tuple[str, int, int]]  # operator, channels of its result, size of its kernel


def network_of(chain: Chain) -> onnx.ModelProto:
    """x (N, 3, H, W) through convolutions and element-wise operators, no gradient; the values are v0, v1, ..."""
    nodes, tensors, value, width = [], [], "x", 3
    for index, (kind, results, size) in enumerate(chain):
        out = f"v{index}"
        if kind == "Conv":
            kernel = np.random.default_rng(index).standard_normal((results, width, size, size)) / size
            tensors.append(numpy_helper.from_array(kernel.astype(np.float32), f"{out}_w"))
            nodes.append(helper.make_node("Conv", [value, f"{out}_w"], [out], name=out, pads=[size // 2] * 4))
            width = results
        else:
            nodes.append(helper.make_node(kind, [value], [out], name=out))
        value = out
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", 3, "H", "W"])
    output = helper.make_tensor_value_info(value, TensorProto.FLOAT, ["N", width, "H", "W"])
    graph = helper.make_graph(nodes, "net", [image], [output], tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


@pytest.mark.parametrize(
    ("chain", "slow"),
    [
        ([("Conv", 64, 3), ("Relu", 64, 0), ("Conv", 64, 3), ("Sin", 64, 0)], []),
        # An output stays as it is, so what makes it runs in floats; nothing pays for what is before it then.
        ([("Conv", 64, 3), ("Relu", 64, 0), ("Conv", 64, 3)], ["v0", "v2"]),
        # Few multiplications, between values in floats.
        ([("Conv", 8, 3), ("Sin", 8, 0)], ["v0"]),
        # The same beside a region that gains, and as a part of one.
        ([("Conv", 8, 3), ("Sin", 8, 0), ("Conv", 64, 5), ("Conv", 64, 3), ("Sin", 64, 0)], ["v0"]),
        ([("Conv", 8, 3), ("Relu", 8, 0), ("Conv", 64, 5), ("Conv", 64, 3), ("Sin", 64, 0)], []),
    ],
)
def test_regions_that_lose_are_found(chain: Chain, slow: list[str]) -> None:
    model, x = network_of(chain), images((24, 32), 1)
    lowered, origins = rewrite(GraphView(model), schemes_of(model, x))
    assert set(origins.values()) == {f"v{index}" for index, (kind, _, _) in enumerate(chain) if kind == "Conv"}
    assert losing(lowered, origins, x) == set(slow)
    kept, others = rewrite(GraphView(model), schemes_of(model, x), slow)
    assert set(others.values()) == set(origins.values()) - set(slow)
    for name in slow:
        (node,) = (node for node in kept.graph.node if node.name == name)
        assert node == next(node for node in model.graph.node if node.name == name)  # as it was


def test_a_strided_convolution_s_adjoint_pays_by_its_channels() -> None:
    """Few channels do not pay for the interleaving, many do; an image's take as long in floats."""
    for width, results, pays in ((4, 16, False), (256, 64, True), (256, 3, False), (4096, 3, False)):
        tensors = {"w": small.weights(width, results, 3, 3), "like": np.zeros((1, results, 31, 47), np.float32)}
        gradient = "g = elf.ConvGrad<strides = [2, 2], pads = [1, 1, 1, 1]>(s, w, like)"
        graph = Graph(small.written(f"s = Sin(x)  {gradient}  y = Abs(g)", tensors, ["N", width, 16, 24]))
        model = lower(graph, "int8").model
        schemes = {name: Scheme(1 / 127 if name == "s" else 0.1, 128) for name in candidates(GraphView(model))}
        lowered, origins = rewrite(GraphView(model), schemes)
        x = np.random.default_rng(0).standard_normal((1, width, 16, 24)).astype(np.float32)
        assert set(origins.values()) <= {node.output[0] for node in model.graph.node}
        assert losing(lowered, origins, x) == (set() if pays else set(origins.values()))


def convolution(kernel: np.ndarray, group: int = 1) -> onnx.ModelProto:
    """x -> Conv -> y."""
    node = helper.make_node("Conv", ["x", "w"], ["y"], name="y", group=group)
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, kernel.shape[1] * group, "H", "W"])
    output = helper.make_tensor_value_info("y", TensorProto.FLOAT, None)
    weights = numpy_helper.from_array(kernel.astype(np.float32), "w")
    graph = helper.make_graph([node], "g", [image], [output], [weights])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


@pytest.mark.parametrize(
    ("results", "channels", "size", "group", "worth"),
    [(8, 3, 3, 1, True), (64, 1, 11, 1, False), (16, 16, 1, 1, False), (32, 32, 1, 1, True), (64, 64, 3, 64, True)],
)
def test_only_what_gains_is_rounded(results: int, channels: int, size: int, group: int, worth: bool) -> None:
    """One channel is padded to four; a 1x1 kernel between few channels computes little for what it reads."""
    model = convolution(np.random.default_rng(0).standard_normal((results, channels // group, size, size)), group)
    assert candidates(GraphView(model)) == (["x", "y"] if worth else [])
    if not worth:
        with pytest.raises(ExportError, match="int8: 8-bit integers make no convolution of this network faster"):
            quantize(model, calibration_set(), InputSpec(), 1.0)


def test_sums_over_channels_stay_in_floats() -> None:
    """Local response normalisation's, of squares: half of their values would be one level of 256."""
    i, j = np.indices((96, 96))
    band = (abs(i - j) <= 2)[:, :, None, None] * 0.5
    assert candidates(GraphView(convolution(band))) == []
    band[0, 0] = 1.0
    assert candidates(GraphView(convolution(band))) == ["x", "y"]
