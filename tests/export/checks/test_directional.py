"""Derivatives along directions: kinks in the way, wrong gradients, and layers whose norm is a constant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import helper

from elf_export import Preprocessing, VerificationError, export_onnx
from elf_export.checks import directional as d
from elf_export.checks import require
from elf_export.checks.arithmetic import FLOAT32, FLOAT64, SIGNS
from elf_export.checks.differences import CONSTANT, HARDLY, DifferencesCheck, require_dependence, require_finite
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
    return np.array([found.error for found in d.along(gated, X, gated(X), g, "8x8", FLOAT64, seed)])


def test_a_direction_that_crosses_a_kink_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    found = np.array([errors(gradient(), seed) for seed in range(5)])
    assert found.max() <= FLOAT64.largest
    assert np.median(found) <= FLOAT64.typical
    monkeypatch.setattr(d, "TRIES", 1)
    assert max(errors(gradient(), seed).max() for seed in range(5)) > FLOAT64.largest


def test_small_kinks_in_most_directions_do_not_hide_a_right_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gate that a step crosses along three directions in four, and that changes the derivative by a few 1e-5."""
    near, opened = float(GATE @ X.ravel()) - 1.5e-7, 3e-3 * OPENED

    def forward(x: np.ndarray) -> np.ndarray:
        return WEIGHTS @ x.ravel() + opened * max(GATE @ x.ravel() - near, 0)

    g = ((WEIGHTS + np.outer(opened, GATE)).T @ forward(X)).reshape(SHAPE)

    def medians() -> list[float]:
        return [
            float(np.median([found.error for found in d.along(forward, X, forward(X), g, "8x8", FLOAT64, seed)]))
            for seed in range(8)
        ]

    assert max(medians()) <= FLOAT64.typical
    monkeypatch.setattr(d, "TRIES", 1)
    assert max(medians()) > FLOAT64.typical


def test_curvature_is_no_kink() -> None:
    """What F does not bend by is not asked for again: two runs for each step, and one at the image."""
    runs = []

    def forward(x: np.ndarray) -> np.ndarray:
        runs.append(x)
        return 300 * x + 40 * x**2

    found = d.along(forward, X, forward(X), forward(X) * (300 + 80 * X), "8x8", FLOAT64, 0)
    assert len(runs) == 2 + 2 * len(FLOAT64.steps) * len(found)


@pytest.mark.parametrize("factor", [0.99, 1.01, 0.01, 100, -1])
def test_a_wrong_factor_is_seen_beside_a_kink(factor: float) -> None:
    """Of the gradient's length only the scale of errors is taken; directions are chosen without it."""
    for seed in range(5):
        assert errors(factor * gradient(), seed).max() > FLOAT64.largest
        assert np.median(errors(factor * gradient(), seed)) > FLOAT64.typical


def test_a_gradient_that_takes_the_gate_for_closed_is_seen() -> None:
    closed = (WEIGHTS.T @ gated(X)).reshape(SHAPE)
    for seed in range(5):
        assert errors(closed, seed).max() > FLOAT64.largest


def normalised() -> onnx.ModelProto:
    """conv2 - y, which is conv2 over its length."""
    nodes, tensors = small.convolutions()
    nodes = [
        *nodes[:4],
        helper.make_node("ReduceL2", ["conv2"], ["length"], axes=[1]),
        helper.make_node("Div", ["conv2", "length"], ["y"]),
    ]
    return small.model(nodes, tensors, ("N", 3, "H", "W"), "y")


def test_a_normalised_layer_is_refused_and_the_one_before_it_taken(tmp_path: Path) -> None:
    onnx.save(normalised(), tmp_path / "model.onnx")
    with pytest.raises(VerificationError, match=r"'y' can't give keypoints: it is normalised.* take the layer before"):
        export_onnx(tmp_path / "model.onnx", "y", [], tmp_path / "elf.onnx")
    assert export_onnx(tmp_path / "model.onnx", "conv2", ["y"], tmp_path / "elf.onnx").path.exists()


def outweighed() -> onnx.ModelProto:
    body = "c = Conv<pads = [1, 1, 1, 1]>(x, w)  r = Relu(c)  y = Add(r, k)"
    return small.written(body, {"w": small.weights(8, 3, 3, 3), "k": np.float32(3000)}, ("N", 3, "H", "W"))


def test_a_layer_whose_constant_outweighs_the_image_is_taken_with_a_word(tmp_path: Path) -> None:
    onnx.save(outweighed(), tmp_path / "model.onnx")
    said: list[str] = []
    found = export_onnx(tmp_path / "model.onnx", "y", [], tmp_path / "elf.onnx", log=said.append)
    assert found.contract.parity["derivative_median_error"] < FLOAT64.typical
    assert "||F||^2 hardly depends on the image" in "\n".join(said)


def test_a_disagreement_says_that_the_norm_hardly_depends_on_the_image() -> None:
    directions = (d.Direction(SIGNS, "64x48", 1.0, 2.0, 0.5),)
    with pytest.raises(VerificationError, match=r"changes it by 2e-05 of itself.*or a constant outweighs it"):
        require(DifferencesCheck(FLOAT32, directions, 0.0, dependence=2e-5))
    with pytest.raises(VerificationError, match="disagrees") as refused:
        require(DifferencesCheck(FLOAT32, directions, 0.0, dependence=2 * HARDLY))
    assert "hardly depends" not in str(refused.value)


def test_how_far_a_norm_must_depend_on_the_image() -> None:
    """F = x + c: a standard deviation of x adds about sum |x + c| std(x) to 1/2 ||F||^2."""
    x = np.random.default_rng(0).standard_normal(SHAPE)
    assert require_dependence("y", x, x, x) > 0.5
    assert require_dependence("y", x + 2000, x + 2000, x) == pytest.approx(5e-4, rel=0.1)
    with pytest.raises(VerificationError, match=r"changes it by 5e-10 of itself"):
        require_dependence("y", x + 2 / CONSTANT, x + 2 / CONSTANT, x)


RAW = Preprocessing(color="rgb", standardize=False, mean=(0.0,), std=(1.0,))


def test_a_layer_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    """The root of what is below 100, beside a ReLU that has a gradient."""
    body = (
        "c = Conv<pads = [1, 1, 1, 1]>(x, w)  r = Relu(c)  k = Sub(top, x)  f = Floor(k)  s = Sqrt(f)  "
        "y = Concat<axis = 1>(r, s)"
    )
    model = small.written(body, {"w": small.weights(4, 3, 3, 3), "top": np.float32(100)}, ("N", 3, "H", "W"))
    onnx.save(model, tmp_path / "model.onnx")
    with pytest.raises(VerificationError, match=r"^'y' is NaN or infinite on a natural image"):
        export_onnx(tmp_path / "model.onnx", "y", [], tmp_path / "elf.onnx", preprocessing=RAW)
    assert not (tmp_path / "elf.onnx").exists()


def test_a_gradient_that_is_not_finite_is_refused() -> None:
    require_finite("y", X, X)
    with pytest.raises(VerificationError, match=r"^the gradient of 'y' is NaN or infinite"):
        require_finite("y", X, X, np.where(X > 0, np.inf, X))


def test_differences_that_are_not_finite_do_not_agree() -> None:
    """F is finite at X alone."""

    def forward(x: np.ndarray) -> np.ndarray:
        return np.where(np.array_equal(x, X), x, np.nan)

    for found in d.along(forward, X, X, X, "8x8", FLOAT64, 0):
        assert np.isnan(found.measured)
        assert found.error == np.inf
