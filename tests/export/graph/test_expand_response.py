"""Local response normalisation by convolutions: the operator's values, its sums computed once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import onnx
import pytest
from onnx import helper

from elf_export.graph import response
from elf_export.graph.graph import Graph
from elf_export.graph.passes import expand_response
from elf_export.precision.half import half_precision
from elf_export.saliency import build_gradient, build_saliency
from elf_runtime.model.session import open_session
from seeded import evaluator64

CHANNELS = 7
SETTINGS = [
    {"size": 5, "alpha": 1e-4},
    {"size": 1, "alpha": 0.5},
    {"size": 4, "alpha": 0.5, "bias": 2.0},  # one channel more behind than before
    {"size": 20, "alpha": 0.3},
    {"size": 3, "alpha": 0.5, "beta": 0.5},
    {"size": 3, "alpha": -1e-3, "bias": 3.0},
]


def normalization(channels: int | str = CHANNELS, **settings: float) -> onnx.ModelProto:
    """image -> ReLU -> LRN -> y."""
    infos = [helper.make_tensor_value_info(n, onnx.TensorProto.FLOAT, ["N", channels, "H", "W"]) for n in ("x", "y")]
    nodes = [
        helper.make_node("Relu", ["x"], ["r"], name="r"),
        helper.make_node("LRN", ["r"], ["y"], name="norm", **settings),
    ]
    graph = helper.make_graph(nodes, "g", infos[:1], infos[1:])
    return helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)])


def values(scale: float = 1.0) -> npt.NDArray[np.float64]:
    return scale * np.random.default_rng(0).standard_normal((2, CHANNELS, 4, 5))


@pytest.mark.parametrize("settings", SETTINGS)
def test_the_values_stay(settings: dict[str, float]) -> None:
    model = normalization(**settings)
    expanded = expand_response(Graph(model)).model
    onnx.checker.check_model(expanded, full_check=True)
    assert "LRN" not in {node.op_type for node in expanded.graph.node}
    found, wanted = (evaluator64(m).run(None, {"x": values()})[0] for m in (expanded, model))
    # The settings are attributes, which ONNX keeps in float32.
    np.testing.assert_allclose(found, wanted, rtol=1e-7)


@pytest.mark.parametrize("settings", SETTINGS)
def test_the_gradient_is_that_of_finite_differences(settings: dict[str, float]) -> None:
    """Of 1/2 |y|^2 along a random direction; windows of an even size too, which the adjoint has to mirror."""
    evaluator = evaluator64(build_gradient(normalization(**settings), "y", "x"))

    def at(x: npt.NDArray[np.float64]) -> tuple[float, npt.NDArray[np.float64]]:
        y, gradient = evaluator.run(["y", "gradient"], {"x": x})
        return 0.5 * float((y**2).sum()), gradient

    x, step = values(), 1e-6
    direction = np.random.default_rng(1).standard_normal(x.shape)
    wanted = (at(x + step * direction)[0] - at(x - step * direction)[0]) / (2 * step)
    assert (at(x)[1] * direction).sum() == pytest.approx(wanted, rel=1e-7)


def test_channels_that_are_not_known_are_left_alone() -> None:
    model = normalization("C", size=5)
    assert expand_response(Graph(model)).model == model


def test_the_saliency_takes_sum_and_root_from_the_forward_pass() -> None:
    ops = [node.op_type for node in build_saliency(normalization(size=5), "y", image_input="x").graph.node]
    assert (ops.count("Conv"), ops.count("Sqrt")) == (2, 2)  # two sums, there and back; d to the power of 3/4


def test_half_precision_holds_the_squares() -> None:
    """1500, as a layer gives that is fed pixels up to 255, squared is far beyond float16's 65504."""
    model = expand_response(Graph(normalization(size=5, alpha=1e-4))).model
    x = values(scale=1500.0).astype(np.float32)
    half, single = (
        open_session(m.SerializeToString())[0].run(None, {"x": x})[0] for m in (half_precision(model), model)
    )
    assert np.isfinite(half).all()
    assert np.abs(half - single).max() <= 3e-3 * single.max()


def test_a_window_on_the_wrong_side_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    right = response.Response._band
    monkeypatch.setattr(response.Response, "_band", lambda self: right(self).T)
    for test in (test_the_values_stay, test_the_gradient_is_that_of_finite_differences):
        with pytest.raises(AssertionError):
            test({"size": 4, "alpha": 0.5})
