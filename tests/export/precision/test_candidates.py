"""Which values 8 bits are chosen for."""

from __future__ import annotations

import numpy as np
import pytest
from onnx import TensorProto, helper

from elf_export.graph.graph import GraphView
from elf_export.precision.int8.candidates import candidates
from elf_export.precision.int8.rewrite import rewrite
from export import small_models as small

from .written import CONV, SHAPE, STEP, TENSORS, drawn, schemes_of


def chosen(body: str, tensors: dict[str, np.ndarray] | None = None) -> list[str]:
    return candidates(GraphView(small.written(body, TENSORS | (tensors or {}), SHAPE)))


@pytest.mark.parametrize(
    ("body", "names"),
    [
        (f"c = {CONV}(x, w)  y = Relu(c)", ["x", "y"]),
        (f"c = {CONV}(x, w)  y = Clip(c, zero, top)", ["x", "y"]),
        (f"c = {CONV}(x, w)  y = Neg(c)", ["x", "c"]),
        # Two readers: the ReLU's result alone does not stand for the convolution's.
        (f"c = {CONV}(x, w)  r = Relu(c)  n = Neg(c)  y = Mul(r, n)", ["x", "c"]),
        (f"c = {CONV}(x, w)  r = Relu(c)  y = Add(r, r)", ["x", "r", "y"]),
        (f"c = {CONV}(x, w)  r = Relu(c)  y = Sum(r, r)", ["x", "r", "y"]),
        (f"c = {CONV}(x, w)  r = Relu(c)  y = Concat<axis = 1>(r, r)", ["x", "r", "y"]),
        (f"c = {CONV}(x, w)  r = Relu(c)  y = AveragePool<kernel_shape = [2, 2]>(r)", ["x", "r", "y"]),
        # What no convolution gains from.
        ("y = AveragePool<kernel_shape = [2, 2]>(x)", []),
        # No map; or none of floats.
        (f"c = {CONV}(x, w)  r = Relu(c)  f = Flatten(r)  y = Add(f, f)", ["x", "r"]),
        (f"c = {CONV}(x, w)  r = Relu(c)  v = Reshape(r, rows)  y = Add(v, v)", ["x", "r"]),
        (f"c = {CONV}(x, w)  r = Relu(c)  i = Cast<to = 7>(r)  j = Add(i, i)  y = Cast<to = 1>(j)", ["x", "r"]),
        # A bias that is computed.
        (f"b = ReduceMax<axes = [0, 2, 3], keepdims = 0>(x)  b4 = Concat<axis = 0>(b, b, b, b)  y = {CONV}(x, w, b4)",
         []),
        # A difference has no bias: with one, a convolution before a step is like any other.
        (f"d = {CONV}(x, w)  y = {STEP}(d)", []),
        (f"d = {CONV}(x, w, bias)  y = {STEP}(d)", ["x", "d"]),
    ],
)  # fmt: skip
def test_the_values_that_may_need_a_scheme(body: str, names: list[str]) -> None:
    assert chosen(body, {"bias": np.ones(16, np.float32)}) == names


def test_an_empty_bias_is_none() -> None:
    node = helper.make_node("Conv", ["x", "w", ""], ["y"], name="y", pads=[1] * 4)
    assert candidates(GraphView(small.model([node], TENSORS, SHAPE, "y"))) == ["x", "y"]


def test_a_convolution_in_double_precision_is_none_of_them() -> None:
    node = helper.make_node("Conv", ["x", "w"], ["y"], name="y", pads=[1] * 4)
    tensors = {"w": TENSORS["w"].astype(np.float64)}
    assert candidates(GraphView(small.model([node], tensors, SHAPE, "y", elem=TensorProto.DOUBLE))) == []


@pytest.mark.parametrize(
    ("results", "channels", "worth"), [(20, 20, True), (19, 20, False), (20, 19, False), (12, 60, True), (60, 12, True)]
)
def test_ten_multiplications_for_each_value_are_worth_rounding(results: int, channels: int, worth: bool) -> None:
    """A 1x1 kernel: C K multiplications for C values read and K written."""
    model = small.written("y = Conv(x, v)", {"v": small.weights(results, channels, 1, 1)}, ["N", channels, "H", "W"])
    assert worth is (results * channels >= 10 * (results + channels))
    assert candidates(GraphView(model)) == (["x", "y"] if worth else [])


def test_a_convolution_along_one_axis_stays_in_floats() -> None:
    """Even where its input is integers that were moved into rows."""
    x = drawn(1, 4, 9, 11)
    body = f"c = {CONV}(x, w)  r = Relu(c)  f = Reshape(r, rows)  e = Conv(f, row)  y = Sin(e)"
    model = small.written(body, TENSORS | {"row": small.weights(16, 16, 3)}, SHAPE)
    _, origins = rewrite(GraphView(model), schemes_of(model, x))
    assert set(origins.values()) == {"c"}
