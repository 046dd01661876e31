"""Rules of QuantizeLinear and DequantizeLinear: straight through, zero where the integers saturate."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from elf_export.adjoint import build_adjoint
from elf_export.errors import UnsupportedGraphError
from elf_export.graph.graph import Graph

from . import test_networks
from .oracles import assert_standard
from .runs import differentiated, one_graph, run_ort, run_reference, with_adjoint

pytestmark = pytest.mark.torch


def pair(
    opset: int, scale: Any, zero: Any, back: Any = None, axis: int | None = None, dtype: Any = np.float32
) -> onnx.ModelProto:
    """y = DQ(Q(x)); `back` is the scale of DQ if it is another one."""
    elem = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
    attrs = {} if axis is None else {"axis": axis}
    tensors = [
        numpy_helper.from_array(np.asarray(scale, dtype), "scale"),
        numpy_helper.from_array(np.asarray(scale if back is None else back, dtype), "back"),
        numpy_helper.from_array(np.asarray(zero), "zero"),
    ]
    nodes = [
        helper.make_node("QuantizeLinear", ["x", "scale", "zero"], ["q"], name="node", **attrs),
        helper.make_node("DequantizeLinear", ["q", "back", "zero"], ["y"], name="node_back", **attrs),
    ]
    info = helper.make_tensor_value_info("x", elem, ["N", 3, "H", "W"])
    return one_graph(nodes, [info], tensors, opset, elem)


@pytest.mark.parametrize("opset", [11, 13, 17, 19, 20])
@pytest.mark.parametrize(("low", "high", "kind"), [(0, 255, np.uint8), (-128, 127, np.int8)])
def test_per_tensor(opset: int, low: int, high: int, kind: Any) -> None:
    """Against torch's fake quantisation, whose gradient is the same."""
    rng = np.random.default_rng(opset)
    scale, zero = 0.01, 0 if kind is np.uint8 else 3
    x = rng.standard_normal((2, 3, 4, 5)).astype(np.float32)
    seed = rng.standard_normal(x.shape).astype(np.float32)
    leaf = torch.tensor(x, requires_grad=True)
    expected_y = torch.fake_quantize_per_tensor_affine(leaf, scale, zero, low, high)
    (expected,) = torch.autograd.grad(expected_y, leaf, torch.from_numpy(seed))
    both = with_adjoint(pair(opset, scale, kind(zero)), "x")
    assert_standard(both)
    y, dx = run_ort(both, {"x": x, "seed": seed})
    np.testing.assert_allclose(y, expected_y.detach().numpy(), atol=1e-6)
    assert np.array_equal(dx, expected.numpy())
    assert 0.1 < np.mean(dx == 0) < 0.9


@pytest.mark.parametrize("opset", [13, 17, 20])
@pytest.mark.parametrize("axis", [1, -3])
def test_per_channel(opset: int, axis: int) -> None:
    rng = np.random.default_rng(opset)
    scale, zero = np.array([0.02, 0.004, 0.01]), np.array([1, -5, 0], np.int8)
    x = rng.standard_normal((2, 3, 4, 5)).astype(np.float32)
    seed = rng.standard_normal(x.shape).astype(np.float32)
    leaf = torch.tensor(x, requires_grad=True)
    y = torch.fake_quantize_per_channel_affine(
        leaf, torch.tensor(scale, dtype=torch.float32), torch.tensor(zero, dtype=torch.int32), 1, -128, 127
    )
    (expected,) = torch.autograd.grad(y, leaf, torch.from_numpy(seed))
    _, dx = run_ort(with_adjoint(pair(opset, scale, zero, axis=axis), "x"), {"x": x, "seed": seed})
    assert np.array_equal(dx, expected.numpy())


@pytest.mark.parametrize("run", [run_ort, run_reference])
def test_two_scales_give_their_ratio(run: Any) -> None:
    dtype = np.float32 if run is run_ort else np.float64
    x = np.linspace(-1, 1, 24).reshape(1, 3, 2, 4).astype(dtype)
    seed = np.ones_like(x)
    _, dx = run(with_adjoint(pair(19, 0.01, np.int8(0), back=0.03, dtype=dtype), "x"), {"x": x, "seed": seed})
    assert dx.dtype == dtype
    np.testing.assert_allclose(dx, 3.0, rtol=1e-6)


def test_unsigned_integers_stand_in_for_a_relu() -> None:
    x = np.array([-0.5, -0.1, 0.1, 0.5], np.float32).reshape(1, 1, 1, 4).repeat(3, 1)
    _, dx = run_ort(with_adjoint(pair(13, 0.01, np.uint8(0)), "x"), {"x": x, "seed": np.ones_like(x)})
    assert dx[0, 0, 0].tolist() == [0, 0, 1, 1]


def test_integers_that_come_from_elsewhere_are_reported() -> None:
    model = pair(17, 0.01, np.uint8(0))
    model.graph.node[1].input[0] = "moved"
    model.graph.node.insert(1, helper.make_node("Identity", ["q"], ["moved"], name="move"))
    with pytest.raises(UnsupportedGraphError, match=r"node_back.*straight from a QuantizeLinear"):
        build_adjoint(Graph(model), "y", "x")


def test_a_scale_that_is_computed_is_reported() -> None:
    model = pair(17, 0.01, np.uint8(0))
    model.graph.node[0].input[1] = "dynamic"
    model.graph.input.append(helper.make_tensor_value_info("dynamic", TensorProto.FLOAT, []))
    with pytest.raises(UnsupportedGraphError) as caught:
        build_adjoint(Graph(model), "y", "x")
    assert [n.name for n in caught.value.nodes] == ["node", "node_back"]


def test_a_network_that_onnx_runtime_quantised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its Relus are gone: the saturation of unsigned integers has taken their place."""
    monkeypatch.setattr(logging.root, "level", logging.ERROR)
    x = np.random.default_rng(0).standard_normal((1, 3, 48, 64)).astype(np.float32)
    torch.manual_seed(0)
    plain = test_networks.exported(test_networks.Residual().eval(), 17)
    before, after = str(tmp_path / "plain.onnx"), str(tmp_path / "quantised.onnx")
    onnx.save(plain, before)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from onnxruntime import quantization

        class Once(quantization.CalibrationDataReader):  # type: ignore[misc]
            def __init__(self) -> None:
                self.left = [{"x": x}]

            def get_next(self) -> dict[str, Any] | None:
                return self.left.pop() if self.left else None

        quantization.quantize_static(
            before,
            after,
            Once(),
            quant_format=quantization.QuantFormat.QDQ,
            per_channel=True,
            activation_type=quantization.QuantType.QUInt8,
            weight_type=quantization.QuantType.QInt8,
        )
    quantised = onnx.load(after)
    assert "Relu" not in {node.op_type for node in quantised.graph.node}
    maps = []
    for model in (plain, quantised):
        graph = Graph(model)
        gradient = differentiated(graph, "y", "x")
        graph.op("Identity", gradient, name="result", outputs=["dx"])
        graph.model.graph.output.append(helper.make_tensor_value_info("dx", 1, ["N", 3, "H", "W"]))
        maps.append(run_ort(graph.model, {"x": x})[1].ravel())
    assert np.corrcoef(*maps)[0, 1] > 0.98
