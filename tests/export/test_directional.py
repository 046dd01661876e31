"""Derivatives along directions: kinks in the way, wrong gradients, and layers whose norm is a constant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import helper

from elf_export import VerificationError, export_onnx
from elf_export import directional as d
from elf_export.differences import CONSTANT, require_dependence
from export import small_models as small

SHAPE = (1, 3, 8, 8)
RNG = np.random.default_rng(0)
WEIGHTS = RNG.standard_normal((40, 192)) / np.sqrt(192)
GATE = RNG.standard_normal(192) / np.sqrt(192)
OPENED = 0.1 * RNG.standard_normal(40)
X = RNG.standard_normal(SHAPE)
NEAR = float(GATE @ X.ravel()) - 3e-7  # the gate opens within the second step of one direction in three


def gated(x: np.ndarray) -> np.ndarray:
    """Linear maps, and a ReLU of one number that is a hair above zero at X; F is 40 values."""
    return WEIGHTS @ x.ravel() + OPENED * max(GATE @ x.ravel() - NEAR, 0)


def gradient() -> np.ndarray:
    return ((WEIGHTS + np.outer(OPENED, GATE)).T @ gated(X)).reshape(SHAPE)


def errors(g: np.ndarray, seed: int) -> np.ndarray:
    return np.array([found.error for found in d.along(gated, X, g, "8x8", d.FLOAT64, seed)])


def test_a_direction_that_crosses_a_kink_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    found = np.array([errors(gradient(), seed) for seed in range(5)])
    assert found.max() <= d.FLOAT64.largest
    assert np.median(found) <= d.FLOAT64.typical
    monkeypatch.setattr(d, "TRIES", 1)
    assert max(errors(gradient(), seed).max() for seed in range(5)) > d.FLOAT64.largest


@pytest.mark.parametrize("factor", [0.99, 1.01, 0.01, 100, -1])
def test_a_wrong_factor_is_seen_beside_a_kink(factor: float) -> None:
    """Of the gradient's length only the scale of errors is taken; directions are chosen without it."""
    for seed in range(5):
        assert errors(factor * gradient(), seed).max() > d.FLOAT64.largest
        assert np.median(errors(factor * gradient(), seed)) > d.FLOAT64.typical


def test_a_gradient_that_takes_the_gate_for_closed_is_seen() -> None:
    closed = (WEIGHTS.T @ gated(X)).reshape(SHAPE)
    for seed in range(5):
        assert errors(closed, seed).max() > d.FLOAT64.largest


def normalised(op: str) -> onnx.ModelProto:
    """conv2 - y, which is conv2 over its length or its deviation."""
    nodes, tensors = small.convolutions()
    nodes = nodes[:4]
    if op == "InstanceNormalization":
        nodes.append(helper.make_node(op, ["conv2", "scale", "bias"], ["y"]))
        tensors |= {"scale": np.ones(4, np.float32), "bias": np.zeros(4, np.float32)}
    else:
        nodes += [
            helper.make_node("ReduceL2", ["conv2"], ["length"], axes=[1]),
            helper.make_node("Div", ["conv2", "length"], ["y"]),
        ]
    return small.model(nodes, tensors, ("N", 3, "H", "W"), "y")


@pytest.mark.parametrize("op", ["InstanceNormalization", "ReduceL2"])
def test_a_normalised_layer_is_refused_and_the_one_before_it_taken(tmp_path: Path, op: str) -> None:
    onnx.save(normalised(op), tmp_path / "model.onnx")
    with pytest.raises(
        VerificationError, match=r"'y' can't give keypoints: it is normalised.* take the layer before"
    ):
        export_onnx(tmp_path / "model.onnx", "y", [], tmp_path / "elf.onnx")
    assert export_onnx(tmp_path / "model.onnx", "conv2", ["y"], tmp_path / "elf.onnx").path.exists()


def test_how_far_a_norm_must_depend_on_the_image() -> None:
    """F = x + c: a standard deviation of x adds about sum |x + c| std(x) to 1/2 ||F||^2."""
    x = np.random.default_rng(0).standard_normal(SHAPE)
    require_dependence("y", x, x, x)
    require_dependence("y", x + 0.5 / CONSTANT, x + 0.5 / CONSTANT, x)
    with pytest.raises(VerificationError, match=r"changes it by 0\.0005 of itself"):
        require_dependence("y", x + 2 / CONSTANT, x + 2 / CONSTANT, x)
