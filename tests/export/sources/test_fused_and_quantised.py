"""elf-export --onnx on what optimisers fuse and quantisers round."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import helper, numpy_helper

from elf_export import LayerError, build_gradient, export_onnx, load_model
from elf_export.graph.graph import Graph
from elf_export.graph.passes import standard_ops, without_rounding
from elf_export.sources.foreign.prepare import prepare
from export import small_models as small
from export.sources.saved_models import saved

pytestmark = pytest.mark.usefixtures("one_direction")


def run(model: onnx.ModelProto, x: np.ndarray, output: str | None = None) -> np.ndarray:
    options = ort.SessionOptions()
    options.log_severity_level = 3
    session = ort.InferenceSession(model.SerializeToString(), options, ["CPUExecutionProvider"])
    return np.asarray(session.run([output] if output else None, {session.get_inputs()[0].name: x})[0])


# -- fused ops -------------------------------------------------------------------------------------------------


def fused(*nodes: onnx.NodeProto, **tensors: np.ndarray) -> onnx.ModelProto:
    model = small.model(list(nodes), tensors, ("N", 3, "H", "W"), "y")
    model.opset_import.append(helper.make_opsetid("com.microsoft", 1))
    return model


ACTIVATIONS: list[tuple[str, list[float]]] = [
    ("Relu", []), ("Sigmoid", []), ("Tanh", []), ("LeakyRelu", [0.2]), ("Clip", [-0.5, 0.5]),
    ("HardSigmoid", [0.3, 0.4]),
]  # fmt: skip


@pytest.mark.parametrize(("activation", "params"), ACTIVATIONS)
@pytest.mark.parametrize("added", [False, True])
def test_a_fused_conv_is_its_parts(tmp_path: Path, activation: str, params: list[float], added: bool) -> None:
    """The same numbers as ONNX Runtime's own kernel, and a gradient that agrees with differences."""
    inputs = ["first", "w2", "b"] + (["first"] if added else [])
    given: dict[str, Any] = {"activation_params": params} if params else {}
    model = fused(
        helper.make_node("Conv", ["x", "w1"], ["first"], name="first", pads=[1] * 4),
        helper.make_node("FusedConv", inputs, ["y"], name="fused", domain="com.microsoft", pads=[1] * 4,
                         activation=activation, **given),
        w1=small.weights(8, 3, 3, 3), w2=small.weights(8, 8, 3, 3, seed=1), b=small.weights(8, seed=2),
    )  # fmt: skip
    x = np.random.default_rng(0).standard_normal((2, 3, 20, 24)).astype(np.float32)
    assert np.allclose(run(standard_ops(Graph(model)).model, x), run(model, x), atol=2e-6)
    assert all(node.domain == "" for node in standard_ops(Graph(model)).model.graph.node)
    parity = export_onnx(saved(model, tmp_path), "y", ["y"], tmp_path / "elf.onnx").contract.parity
    assert parity["derivative_median_error"] < 1e-6
    assert build_gradient(model, "y").graph.output[1].name == "gradient"


@pytest.mark.parametrize("op", ["Gelu", "QuickGelu", "BiasGelu"])
def test_gelus_of_onnx_runtime(op: str) -> None:
    inputs = ["flat", "b"] if op == "BiasGelu" else ["flat"]
    model = fused(
        helper.make_node("Transpose", ["x"], ["flat"], name="flat", perm=[0, 2, 3, 1]),
        helper.make_node(op, inputs, ["y"], name="gelu", domain="com.microsoft"), b=np.float32([0.1, -0.2, 0.3]),
    )  # fmt: skip
    x = np.random.default_rng(0).standard_normal((2, 3, 20, 24)).astype(np.float32)
    assert np.allclose(run(standard_ops(Graph(model)).model, x), run(model, x), atol=1e-6)


# -- quantised networks ----------------------------------------------------------------------------------------


def quantizable() -> onnx.ModelProto:
    """Most of what has a quantised form: convolutions, a sum, a product, a concatenation, pools, activations."""
    nodes, tensors = small.convolutions()
    nodes += [
        helper.make_node("Conv", ["relu2", "w3"], ["conv3"], name="conv3", pads=[1] * 4),
        helper.make_node("Add", ["conv3", "relu2"], ["sum"], name="sum"),
        helper.make_node("Sigmoid", ["sum"], ["gate"], name="gate"),
        helper.make_node("Mul", ["sum", "gate"], ["silu"], name="silu"),
        helper.make_node("LeakyRelu", ["silu"], ["leaky"], name="leaky", alpha=0.1),
        helper.make_node("Concat", ["leaky", "sum"], ["both"], name="both", axis=1),
        helper.make_node("AveragePool", ["both"], ["pooled"], name="pooled", kernel_shape=[2, 2], strides=[2, 2]),
        helper.make_node("Resize", ["pooled", "", "scales"], ["large"], name="large", mode="nearest",
                         coordinate_transformation_mode="asymmetric", nearest_mode="floor"),
        helper.make_node("Conv", ["large", "w4"], ["y"], name="y", pads=[1] * 4),
    ]  # fmt: skip
    tensors |= {"w3": small.weights(4, 4, 3, 3, seed=4), "w4": small.weights(5, 8, 3, 3, seed=5),
                "scales": np.float32([1, 1, 2, 2])}  # fmt: skip
    return small.model(nodes, tensors, ("N", 3, "H", "W"), "y")


@pytest.fixture
def quantise(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setattr(logging.root, "level", logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from onnxruntime import quantization as q

        class Images(q.CalibrationDataReader):  # type: ignore[misc]
            def __init__(self) -> None:
                rng = np.random.default_rng(0)
                self.left = [{"x": rng.standard_normal((1, 3, 64, 64)).astype(np.float32)} for _ in range(4)]

            def get_next(self) -> dict[str, np.ndarray] | None:
                return self.left.pop() if self.left else None

        def make(model: onnx.ModelProto, folder: Path, form: str, **options: Any) -> onnx.ModelProto:
            source, target = folder / "float.onnx", folder / "eight.onnx"
            onnx.save(model, source)
            if form == "dynamic":
                q.quantize_dynamic(source, target, **options)
            else:
                options |= {"quant_format": q.QuantFormat[form], "weight_type": q.QuantType.QInt8}
                q.quantize_static(source, target, Images(), **options)
            return onnx.load(target)

        yield make


@pytest.mark.parametrize("form", ["QDQ", "QOperator"])
@pytest.mark.parametrize("per_channel", [False, True])
def test_a_quantised_network_is_exported_without_its_rounding(
    quantise: Any, tmp_path: Path, form: str, per_channel: bool
) -> None:
    plain = quantizable()
    eight = quantise(plain, tmp_path, form, per_channel=per_channel)
    assert ("QLinearConv" in {node.op_type for node in eight.graph.node}) == (form == "QOperator")
    lines: list[str] = []
    result = export_onnx(saved(eight, tmp_path), "y", [], tmp_path / "elf.onnx", log=lines.append)
    assert lines[0].startswith("the model is quantised: ")
    assert result.contract.parity["derivative_median_error"] < 1e-6
    source = prepare(load_model(tmp_path / "model.onnx"), ["y"])
    assert not {"QuantizeLinear", "DequantizeLinear"} & {node.op_type for node in source.model.graph.node}
    x = np.random.default_rng(9).standard_normal((1, 3, 64, 64)).astype(np.float32)
    wanted, rounded, found = run(plain, x), run(eight, x), run(source.model, x)
    error = [float(np.sqrt(np.mean((values - wanted) ** 2)) / wanted.std()) for values in (rounded, found)]
    assert error[1] < 0.02  # what is left is the rounding of the weights
    assert error[1] < 0.7 * error[0]
    gradients = [run(build_gradient(model, "y"), x, "gradient") for model in (plain, source.model)]
    assert np.corrcoef(*(g.ravel() for g in gradients))[0, 1] > 0.99


def test_a_quantised_operator_is_its_quantised_parts(quantise: Any, tmp_path: Path) -> None:
    """Before the rounding is taken out, the rewritten graph gives ONNX Runtime's own integers.

    To a few steps: where the two round a half to different sides, the layers behind see another integer.
    """
    eight = quantise(quantizable(), tmp_path, "QOperator", per_channel=True)
    x = np.random.default_rng(9).standard_normal((1, 3, 64, 64)).astype(np.float32)
    wanted, found = run(eight, x), run(standard_ops(Graph(eight)).model, x)
    (step,) = (numpy_helper.to_array(t) for t in eight.graph.initializer if t.name == "y_scale")
    apart = np.abs(found - wanted) / step
    assert apart.max() < 4.5
    assert apart.mean() < 0.5


def test_scales_that_are_computed_are_refused(quantise: Any, tmp_path: Path) -> None:
    eight = quantise(small.convnext(), tmp_path, "dynamic")
    assert "DynamicQuantizeLinear" in {node.op_type for node in eight.graph.node}
    with pytest.raises(LayerError, match=r"in a way that can't be taken out: node .* \(DynamicQuantizeLinear\)"):
        export_onnx(saved(eight, tmp_path), "y", [], tmp_path / "elf.onnx")


def test_two_scales_and_a_relu_by_saturation() -> None:
    """DQ by another scale and zero than Q: (clip(x) / s + z - z') s'."""
    tensors = {"s": np.float32(0.1), "z": np.uint8(10), "s2": np.float32(0.2), "z2": np.uint8(20)}
    nodes = [
        helper.make_node("QuantizeLinear", ["x", "s", "z"], ["q"], name="q"),
        helper.make_node("DequantizeLinear", ["q", "s2", "z2"], ["y"], name="y"),
    ]
    model, count = without_rounding(small.model(nodes, tensors, ("N", 3, "H", "W"), "y"))
    assert count == 2
    x = np.float32([-5.0, -1.0, -0.5, 0.0, 3.0, 24.4, 30.0]).reshape(1, 1, 1, 7).repeat(3, 1)
    wanted = [-4.0, -4.0, -3.0, -2.0, 4.0, 46.8, 47.0]
    assert run(model, x)[0, 0, 0] == pytest.approx(wanted, abs=1e-5)
