"""elf-export --onnx on models of other opsets: what is converted must compute what its file does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import helper

from elf_export import ExportError, Preprocessing, export_onnx
from elf_export.sources.foreign import prepare
from export import small_models as small

pytestmark = pytest.mark.usefixtures("one_direction")

PIXELS = Preprocessing(color="rgb", standardize=False)  # as they are: the network's own input


def resizing(op: str, opset: int, mode: str, scales: tuple[float, float], computed: bool = False) -> onnx.ModelProto:
    """A convolution, another size, and a convolution; the scales are constants, or found when the network runs."""
    tensors = {"w1": small.weights(8, 3, 3, 3), "w2": small.weights(4, 8, 3, 3, seed=1)}
    inputs, given = ["relu"], {}
    nodes = [
        helper.make_node("Conv", ["x", "w1"], ["conv"], name="conv", pads=[1] * 4, strides=[2, 2]),
        helper.make_node("Relu", ["conv"], ["relu"], name="relu"),
    ]
    if opset == 7:
        given["scales"] = [1.0, 1.0, *scales]
    elif not computed:
        tensors["scales"] = np.array([1, 1, *scales], np.float32)
        inputs.append("scales")
    else:
        # As torch writes a size taken from another map: the map's sizes over the own ones.
        tensors |= {"one": np.ones(2, np.float32), "two": np.array([2]), "four": np.array([4])}
        nodes += [
            helper.make_node("Shape", ["x"], ["wanted"]), helper.make_node("Shape", ["relu"], ["own"]),
            *(node for name in ("wanted", "own") for node in (
                helper.make_node("Slice", [name, "two", "four"], [f"{name}_ends"]),
                helper.make_node("Cast", [f"{name}_ends"], [f"{name}_f"], to=1),
            )),
            helper.make_node("Div", ["wanted_f", "own_f"], ["ratio"]),
            helper.make_node("Concat", ["one", "ratio"], ["scales"], axis=0),
        ]  # fmt: skip
        inputs.append("scales")
    nodes += [
        helper.make_node(op, inputs, ["large"], name="large", mode=mode, **given),
        helper.make_node("Conv", ["large", "w2"], ["y"], name="y", pads=[1] * 4),
    ]
    if computed and opset < 10:  # Slice took attributes then
        for node in nodes:
            if node.op_type == "Slice":
                del node.input[1:]
                node.attribute.extend([helper.make_attribute("starts", [2]), helper.make_attribute("ends", [4])])
    return small.model(nodes, tensors, ("N", 3, "H", "W"), "y", opset, ir_version=4)


def descriptors_of(path: Path, pixels: np.ndarray) -> np.ndarray:
    options = ort.SessionOptions()
    options.log_severity_level = 4
    session = ort.InferenceSession(str(path), options, ["CPUExecutionProvider"])
    found = session.run(["descriptors_y"], {"image": np.ascontiguousarray(pixels.transpose(0, 2, 3, 1))})[0]
    return np.asarray(found).transpose(0, 3, 1, 2)


@pytest.mark.parametrize("mode", ["nearest", "linear"])
@pytest.mark.parametrize(
    ("op", "opset", "scales", "computed"),
    [("Upsample", 7, (2, 2), False), ("Upsample", 9, (2, 2), False), ("Upsample", 9, (1.5, 1.5), False),
     ("Upsample", 9, (2, 2), True), ("Resize", 10, (3, 3), False), ("Resize", 10, (2, 2), True),
     ("Resize", 10, (0.6, 0.6), False)],
)  # fmt: skip
def test_an_old_resize_keeps_the_places_of_its_pixels(
    tmp_path: Path, op: str, opset: int, mode: str, scales: tuple[float, float], computed: bool
) -> None:
    """Before opset 11 pixels lie at i / scale; since then Resize has other places, unless it states them."""
    model = resizing(op, opset, mode, scales, computed)
    onnx.save(model, tmp_path / "old.onnx")
    made = export_onnx(tmp_path / "old.onnx", "y", ["y"], tmp_path / "elf.onnx", preprocessing=PIXELS)
    options = ort.SessionOptions()
    options.log_severity_level = 4
    session = ort.InferenceSession(model.SerializeToString(), options, ["CPUExecutionProvider"])
    for height, width in ((53, 71), (97, 120), (64, 64)):
        pixels = np.random.default_rng(0).random((1, 3, height, width)).astype(np.float32)
        wanted = session.run(None, {"x": pixels})[0]
        found = descriptors_of(made.path, pixels)
        assert found.shape == wanted.shape
        assert np.abs(found - wanted).max() < 1e-5 * np.abs(wanted).max()


def test_a_conversion_that_changes_the_network_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(model: onnx.ModelProto, wanted: int | None = None) -> onnx.ModelProto:
        result = small.nchw(("N", 3, "H", "W"), 13)
        next(n for n in result.graph.node if n.op_type == "MaxPool").attribute.append(
            helper.make_attribute("pads", [0, 0, 1, 1])
        )
        return result

    onnx.save(small.nchw(("N", 3, "H", "W"), 9), tmp_path / "old.onnx")
    monkeypatch.setattr(prepare, "convert_opset", wrong)
    with pytest.raises(ExportError, match="converted from opset 9 to 13, but it does not give what it gave in opset 9"):
        export_onnx(tmp_path / "old.onnx", "relu2", [], tmp_path / "elf.onnx")
    assert not (tmp_path / "elf.onnx").exists()


@pytest.mark.parametrize("op", ["Softmax", "LogSoftmax"])
@pytest.mark.parametrize("axis", [1, 2, 3])
def test_a_softmax_of_opset_12_goes_over_all_axes_behind_its_own(tmp_path: Path, op: str, axis: int) -> None:
    nodes, tensors = small.convolutions()
    nodes.append(helper.make_node(op, ["relu2"], ["y"], name="y", axis=axis))
    model = small.model(nodes, tensors, ("N", 3, "H", "W"), "y", 12)
    onnx.save(model, tmp_path / "model.onnx")
    lines: list[str] = []
    scaled = Preprocessing(color="rgb", standardize=False, scale=1 / 255)
    made = export_onnx(tmp_path / "model.onnx", "y", [], tmp_path / "elf.onnx", preprocessing=scaled, log=lines.append)
    assert made.contract.parity["derivative_median_error"] < 1e-6
    assert any("in float64" in line for line in lines)


@pytest.mark.parametrize(
    ("op", "opset", "reason"),
    [("Swish", 24, "Swish means something else there, or does not exist"), ("Relu", 99, "it knows opsets up to")],
)
def test_what_can_t_be_converted_is_said_in_words(tmp_path: Path, op: str, opset: int, reason: str) -> None:
    nodes, tensors = small.convolutions()
    nodes.append(helper.make_node(op, ["relu2"], ["y"], name="y"))
    onnx.save(small.model(nodes, tensors, ("N", 3, "H", "W"), "y", opset), tmp_path / "model.onnx")
    with pytest.raises(ExportError, match=f"can't convert it to 20: {reason}") as raised:
        export_onnx(tmp_path / "model.onnx", "y", [], tmp_path / "elf.onnx")
    assert "Assertion" not in str(raised.value)


def test_integers_of_16_bits_that_only_opset_21_has(tmp_path: Path) -> None:
    """They are taken out before the model is converted: opset 20 could not hold them."""
    nodes, tensors = small.convolutions()
    nodes += [
        helper.make_node("QuantizeLinear", ["relu2", "step", "zero"], ["q"], name="q"),
        helper.make_node("DequantizeLinear", ["q", "step", "zero"], ["y"], name="y"),
    ]
    tensors |= {"step": np.float32(1e-3), "zero": np.uint16(0)}
    onnx.save(small.model(nodes, tensors, ("N", 3, "H", "W"), "y", 21, ir_version=10), tmp_path / "model.onnx")
    made = export_onnx(tmp_path / "model.onnx", "y", [], tmp_path / "elf.onnx")
    assert made.contract.parity["derivative_median_error"] < 1e-7
