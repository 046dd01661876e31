"""Raw pixels to what a network was trained on: the graph against numpy in float64, and the options and words for it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper

from elf_export import Preprocessing
from elf_export.command.asked import preprocessing_of
from elf_export.command.options import parser
from elf_export.graph.graph import Graph
from elf_export.preprocessing import conversion, prepend
from helpers import textured

CODES = {
    ("bgr", "rgb"): cv2.COLOR_BGR2RGB,
    ("rgb", "bgr"): cv2.COLOR_RGB2BGR,
    ("bgr", "gray"): cv2.COLOR_BGR2GRAY,
    ("rgb", "gray"): cv2.COLOR_RGB2GRAY,
    ("gray", "bgr"): cv2.COLOR_GRAY2BGR,
    ("gray", "rgb"): cv2.COLOR_GRAY2RGB,
}


def front(settings: Preprocessing, shape: Any, layout: str = "NCHW", color: str | None = None) -> onnx.ModelProto:
    """A network that multiplies its image by a second input, with the preprocessing put in front."""
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("x", "y")]
    gain = helper.make_tensor_value_info("gain", TensorProto.FLOAT, [1])
    node = helper.make_node("Mul", ["x", "gain"], ["y"], name="y")
    proto = helper.make_graph([node], "g", [infos[0], gain], infos[1:])
    graph = Graph(helper.make_model(proto, opset_imports=[helper.make_opsetid("", 17)], ir_version=8))
    prepend(graph, "x", settings, color=color, layout=layout)
    onnx.checker.check_model(graph.model, full_check=True)
    return graph.model


def run(model: onnx.ModelProto, pixels: np.ndarray) -> np.ndarray:
    session = ort.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return np.asarray(session.run(None, {"image": pixels, "gain": np.ones(1, np.float32)})[0])


def inputs(model: onnx.ModelProto) -> dict[str, list[int | str]]:
    shapes = {value.name: value.type.tensor_type.shape.dim for value in model.graph.input}
    return {name: [d.dim_value or d.dim_param for d in dims] for name, dims in shapes.items()}


def recolored(pixels: np.ndarray, source: str, target: str) -> np.ndarray:
    """(N, H, W, C) by OpenCV."""
    found = [cv2.cvtColor(one, CODES[source, target]) if source != target else one for one in pixels]
    return np.stack(found).reshape(*pixels.shape[:3], -1)


COLORS = ("bgr", "rgb", "gray")


@pytest.mark.parametrize("source", COLORS)
@pytest.mark.parametrize("target", COLORS)
def test_colours_are_converted_as_opencv_does(source: str, target: str) -> None:
    pixels = textured(20, 30, channels=1 if source == "gray" else 3).astype(np.float32)[None]
    wanted = recolored(pixels, source, target)
    assert conversion(source, target).shape == (pixels.shape[3], wanted.shape[3])
    np.testing.assert_allclose(pixels @ conversion(source, target), wanted, atol=1e-4)


RANGES = {
    "bgr": Preprocessing("bgr", False, 1 / 255, (0.4, 0.5, 0.6), (0.2, 0.25, 0.3)),
    "rgb": Preprocessing("rgb", False, 0.5, (100.0,), (3.0, 5.0, 7.0)),
    "gray": Preprocessing("gray", False, 1 / 127.5, (1.0,), (2.0,)),
}


@pytest.mark.parametrize("layout", ["NCHW", "NHWC"])
@pytest.mark.parametrize("source", COLORS)
@pytest.mark.parametrize("target", COLORS)
@pytest.mark.parametrize("standardize", [True, False])
def test_the_graph_is_numpy_s_formula(layout: str, source: str, target: str, standardize: bool) -> None:
    """Of each image of a batch by itself, from one colour order to another, for either layout."""
    settings = Preprocessing(target) if standardize else RANGES[target]
    channels = 1 if source == "gray" else 3
    pixels = np.stack([textured(20, 30, 0, channels), textured(20, 30, 1, channels) // 4]).astype(np.float32)
    x = recolored(pixels, source, target).astype(np.float64)
    if standardize:
        wanted = np.stack([(one - one.mean()) / one.std() for one in x])
    else:
        wanted = (x * settings.scale - np.array(settings.mean)) / np.array(settings.std)
    sizes = {"N": "n", "C": settings.channels, "H": "h", "W": "w"}
    model = front(settings, [sizes[axis] for axis in layout], layout, source)
    assert inputs(model) == {"image": ["N", "H", "W", channels], "gain": [1]}
    found = run(model, pixels)
    wanted = wanted.transpose(0, 3, 1, 2) if layout == "NCHW" else wanted
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=2e-5)


def test_the_colour_order_is_the_network_s_own_unless_told() -> None:
    assert Preprocessing().color == "bgr"
    model = front(RANGES["rgb"], ["n", 3, "h", "w"])
    pixels = textured(8, 9).astype(np.float32)[None]
    wanted = (pixels.astype(np.float64) * 0.5 - 100) / (3, 5, 7)
    np.testing.assert_allclose(run(model, pixels), wanted.transpose(0, 3, 1, 2), atol=1e-4)


@pytest.mark.parametrize(("layout", "shape"), [("NCHW", (1, 3, 40, 48)), ("NHWC", (1, 40, 48, 3))])
def test_a_fixed_size_stays(layout: str, shape: tuple[int, ...]) -> None:
    assert inputs(front(Preprocessing("rgb"), shape, layout, "gray"))["image"] == [1, 40, 48, 1]


def test_many_bright_pixels_of_little_contrast_are_standardised() -> None:
    """One float32 sum of so many is off by 3e-3 of the largest value, and 1.5e-6 are left by sums over rows."""
    pixels = (254 + (np.random.default_rng(0).random((1, 1000, 1600, 3)) < 0.3)).astype(np.float32)
    x = pixels.astype(np.float64)
    wanted = ((x - x.mean()) / x.std()).transpose(0, 3, 1, 2)
    found = run(front(Preprocessing(), ["n", 3, "h", "w"]), pixels)
    assert np.abs(found - wanted).max() < 2e-5 * np.abs(wanted).max()


def test_only_a_flat_image_is_held_from_being_divided_by_nothing() -> None:
    model = front(Preprocessing("gray"), ["n", 1, "h", "w"])
    flat = np.full((1, 16, 16, 1), 77, np.float32)
    np.testing.assert_array_equal(run(model, flat), np.zeros((1, 1, 16, 16)))
    flat[0, 3, 4] += 2.0**-10  # a standard deviation of 6.1e-5
    x = flat.astype(np.float64)
    np.testing.assert_allclose(run(model, flat)[0, 0], ((x - x.mean()) / x.std())[0, :, :, 0], rtol=1e-4)


@pytest.mark.parametrize(
    "settings",
    [*RANGES.values(), Preprocessing("rgb"), Preprocessing("gray"),
     Preprocessing("bgr", False, 1 / 3, (0.1 + 0.2, 1e-9, -2.0), (1.0000001, 2.0, 3.0))],
)  # fmt: skip
def test_the_options_say_the_same_to_the_last_digit(settings: Preprocessing) -> None:
    args = parser().parse_args(["--onnx", "a.onnx", *settings.words()])
    found = preprocessing_of(args)
    assert found is not None
    assert (found.color, found.standardize, found.scale) == (settings.color, settings.standardize, settings.scale)
    assert (tuple(found.mean), tuple(found.std)) == (tuple(settings.mean), tuple(settings.std))


def test_the_words_for_it() -> None:
    assert RANGES["bgr"].describe() == "bgr, (I * 0.00392157 - [0.4, 0.5, 0.6]) / [0.2, 0.25, 0.3]"
    wanted = "gray, (I - mean(I)) / std(I) over all pixels and channels of each image"
    assert Preprocessing("gray").describe() == wanted
