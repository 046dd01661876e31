"""What ONNX Runtime makes of a graph in 8 bits, and what stays in floats."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from elf_export.calibration import calibration_set
from elf_export.graph.graph import Graph, GraphView
from elf_export.precision.int8 import quantize
from elf_export.precision.int8.candidates import candidates
from elf_export.precision.int8.convolve import FINE
from elf_export.precision.int8.rewrite import rewrite
from elf_export.precision.int8.scheme import Scheme, reaching
from elf_export.saliency import build_saliency
from elf_export.sources.forward import NETWORK_INPUT
from elf_export.sources.networks import get_network
from elf_runtime import InputSpec
from export.exported import Exported
from helpers import textured

from .rounded_networks import NETWORKS, forward, images, rounded_values, saliency, schemes_of, session


def test_small_gradients_are_kept_more_finely() -> None:
    """|y| over a fine ramp: it never falls, and is off by half a fine step, half a coarse one beyond."""
    step = 1.0 / 255
    kernel = np.zeros((3, 4, 3, 3), np.float32)
    kernel[:, 0, 1, 1], kernel[:, 1, 1, 1] = 1.0, 1.0 / 63  # whole numbers of their step
    nodes = [
        helper.make_node("Conv", ["x", "w"], ["y"], name="y", pads=[1] * 4),
        helper.make_node("Abs", ["y"], ["magnitude"], name="magnitude"),
    ]
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 4, 1, "W"])
    output = helper.make_tensor_value_info("magnitude", TensorProto.FLOAT, [1, 3, 1, "W"])
    graph = helper.make_graph(nodes, "g", [image], [output], [numpy_helper.from_array(kernel, "w")])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    scheme = Scheme(1.0 / 127, 128)
    lowered, _ = rewrite(GraphView(model), {"x": Scheme(step), "y": scheme})
    first, second = np.divmod(np.arange(256 * 63), 63)
    x = np.zeros((1, 4, 1, len(first)), np.float32)
    x[0, 0, 0], x[0, 1, 0] = first * np.float32(step), second * np.float32(step)
    for optimized in (True, False):
        (found,) = session(lowered, optimized=optimized).run(None, {"x": x})
        exact = (first + second / 63) * step
        for channel in found[0, :, 0]:
            assert (np.diff(channel) >= 0).all()
            fine = exact < 126 / 127 / FINE
            assert 900 < fine.sum() < 1100
            assert np.abs(channel - exact)[fine].max() <= 0.51 * scheme.scale / FINE
            assert np.abs(channel - exact)[exact <= 1].max() <= 0.51 * scheme.scale
            assert (channel[exact > 1] == 1).all()


@pytest.fixture(scope="module")
def vgg8(vgg: Exported, tmp_path_factory: pytest.TempPathFactory) -> tuple[onnx.ModelProto, onnx.ModelProto]:
    """ELF-VGG pool2, which describes by itself too, in float32 and in 8 bits, fitted to two pictures."""
    network, folder = get_network("vgg"), tmp_path_factory.mktemp("pictures")
    for seed in range(2):
        cv2.imwrite(str(folder / f"{seed}.png"), textured(96, 128, seed))
    floats = build_saliency(vgg.forward, "pool2", [], NETWORK_INPUT, network.preprocessing, lowering="int8", masks=True)
    return floats, quantize(floats, calibration_set(folder), InputSpec(), 1.0)


def test_onnx_runtime_convolves_integers_all_the_way(
    vgg8: tuple[onnx.ModelProto, onnx.ModelProto], tmp_path: Path
) -> None:
    """Every convolution is fused, none is left in floats, and between them no value becomes a float."""
    _, lowered = vgg8
    session(lowered, tmp_path / "optimized.onnx")
    nodes = onnx.load(tmp_path / "optimized.onnx").graph.node
    kinds = Counter(node.op_type for node in nodes)
    assert kinds["QLinearConv"] == sum(node.op_type == "Conv" for node in lowered.graph.node)
    network = {node.op_type for node in nodes if not node.name.startswith("pre/")}
    assert not network & {"Conv", "FusedConv", "ConvTranspose", "MaxPool", "HardSigmoid", "Sign"}
    assert kinds["QuantizeLinear"] == 2  # the image, and what rounding leaves of it
    readers = Graph(onnx.load(tmp_path / "optimized.onnx")).consumers()
    floats = [node.output[0] for node in nodes if node.op_type == "DequantizeLinear"]
    assert sorted(reader.op_type for value in floats for reader in readers[value]) == ["Abs", "Abs", "Sub"]


@pytest.mark.parametrize("size", [(64, 80), (67, 81), (33, 34)])
def test_sizes_and_batches(vgg8: tuple[onnx.ModelProto, onnx.ModelProto], size: tuple[int, int]) -> None:
    floats, lowered = vgg8
    pixels = np.stack([textured(*size, seed) for seed in (5, 6)]).astype(np.float32)
    (both,) = session(lowered).run(None, {"image": pixels})
    (wanted,) = session(floats).run(None, {"image": pixels})
    assert both.shape == (2, *size)
    for image, together, exact in zip(pixels, both, wanted, strict=True):
        (alone,) = session(lowered).run(None, {"image": image[None]})
        np.testing.assert_array_equal(alone[0], together)
        assert np.corrcoef(together.ravel(), exact.ravel())[0, 1] > 0.9


def test_an_output_keeps_its_name_and_its_values() -> None:
    """A descriptor that the 8-bit path makes is rounded where convolutions read it, and not as an output."""
    model, x = forward(["conv3", "relu", "conv3", "relu"]), images()
    both = build_saliency(model, "v3", ["v1", "v3"], "x", lowering="int8", masks=True)
    lowered, _ = rewrite(GraphView(both), schemes_of(both, x))
    names = [value.name for value in both.graph.output]
    assert [value.name for value in lowered.graph.output] == names == ["saliency", "descriptors_v1", "descriptors_v3"]
    exact = dict(zip(names, session(both).run(None, {"x": x}), strict=True))
    found = dict(zip(names, session(lowered).run(None, {"x": x}), strict=True))
    for name in names[1:]:
        assert found[name].shape == exact[name].shape
        spread = np.abs(found[name] - exact[name]).mean() / np.abs(exact[name]).mean()
        assert spread < 0.05, name


def test_what_is_not_two_dimensional_stays_in_floats() -> None:
    kernel = numpy_helper.from_array(np.ones((4, 3, 3), np.float32), "w")
    node = helper.make_node("Conv", ["x", "w"], ["y"], name="y")
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 3, "W"])
    output = helper.make_tensor_value_info("y", TensorProto.FLOAT, None)
    graph = helper.make_graph([node], "g", [image], [output], [kernel])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    assert candidates(GraphView(model)) == []
    assert [n.op_type for n in rewrite(GraphView(model), {})[0].graph.node] == ["Conv"]


def test_a_clip_reaches_its_bound_whatever_was_seen() -> None:
    """Levels that end below it would let gradients pass where the network saturates."""
    model, x = saliency(NETWORKS["clipped"]), images()
    schemes = schemes_of(model, x) | {"v1": Scheme(0.3 / 255)}
    found = rounded_values(rewrite(GraphView(model), schemes)[0])["v1"]
    assert found == reaching(1.0)
    assert np.float32(found.scale) * np.float32(255) == 1
