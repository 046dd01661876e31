"""Which values 8 bits are chosen for."""

from __future__ import annotations

import numpy as np
import pytest
from onnx import TensorProto, helper

from elf_export.adjoint.gradient import ADJOINT
from elf_export.graph.graph import GraphView
from elf_export.precision.int8.candidates import candidates, is_steep
from elf_export.precision.int8.rewrite import rewrite
from export import small_models as small

from .rounded_networks import session
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


SPREAD = {"strides": [2, 2], "pads": [1, 1, 0, 0]}
CROP: dict[str, list[int]] = {"starts": [0, 0], "ends": [17, 21], "axes": [2, 3]}


@pytest.mark.parametrize(
    ("given", "crop", "kernel", "spreads"),
    [
        ({}, {}, (16, 16, 3, 3), True),
        ({}, {"ends": [18, 22]}, (16, 16, 3, 3), True),
        ({"output_padding": [1, 1]}, {"ends": [18, 22]}, (16, 16, 3, 3), True),
        ({"group": 16}, {}, (16, 1, 3, 3), True),
        ({"pads": [2, 2, 0, 0]}, {"ends": [16, 20]}, (16, 16, 3, 3), True),
        ({}, {"starts": [0, 0, 0], "ends": [16, 17, 21], "axes": [1, -2, -1]}, (16, 16, 3, 3), True),
        ({"group": 2}, {}, (16, 8, 3, 3), False),
        ({"dilations": [2, 2]}, {}, (16, 16, 3, 3), False),
        ({"strides": [1, 1]}, {"ends": [9, 11]}, (16, 16, 3, 3), False),
        ({"strides": None}, {"ends": [9, 11]}, (16, 16, 3, 3), False),
        ({"strides": [2, 1]}, {"ends": [17, 11]}, (16, 16, 3, 3), False),
        ({"pads": [3, 3, 0, 0]}, {"ends": [15, 19]}, (16, 16, 3, 3), False),
        ({"pads": [1, 1, 1, 0]}, {"ends": [16, 21]}, (16, 16, 3, 3), False),
        ({"pads": None, "auto_pad": "SAME_UPPER"}, {}, (16, 16, 3, 3), False),
        ({"pads": None, "output_shape": [17, 21]}, {}, (16, 16, 3, 3), False),
        ({}, {"starts": [1, 0]}, (16, 16, 3, 3), False),
        # It has 18 rows and 22 columns, and what the convolutions make has 20 and 24.
        ({}, {"ends": [-1, -1]}, (16, 16, 3, 3), False),
        ({}, {"ends": [17, 2**31 - 1]}, (16, 16, 3, 3), False),
        ({}, {"ends": [19, 22]}, (16, 16, 3, 3), False),
        ({}, {"starts": [0], "ends": [17], "axes": [2]}, (16, 16, 3, 3), False),
        ({}, {"starts": [0], "ends": [8], "axes": [1]}, (16, 16, 3, 3), False),
    ],
)
def test_transposed_convolutions_that_convolutions_can_take_the_place_of(
    given: dict[str, list[int]], crop: dict[str, list[int]], kernel: tuple[int, ...], spreads: bool
) -> None:
    """And what is read of the result keeps its size, and its values."""
    form = {key: value for key, value in (SPREAD | given).items() if value is not None}
    nodes = [
        helper.make_node("Conv", ["x", "w"], ["c"], name="c", pads=[1] * 4),
        helper.make_node("Sin", ["c"], ["s"], name="s"),
        helper.make_node("ConvTranspose", ["s", "v"], ["full"], name="full", **form),
        helper.make_node("Slice", ["full", "starts", "ends", "axes"], ["part"], name="part"),
        helper.make_node("Neg", ["part"], ["y"], name="y"),
    ]
    bounds = {key: np.array(value) for key, value in (CROP | crop).items()}
    model = small.model(nodes, TENSORS | {"v": small.weights(*kernel, seed=2)} | bounds, [1, 4, 9, 11], "y")
    assert candidates(GraphView(model)) == ["x", "c", *(["s", "full"] if spreads else [])]
    x = drawn(1, 4, 9, 11)
    lowered, _ = rewrite(GraphView(model), schemes_of(model, x))
    (found,), (wanted,) = (session(m).run(None, {"x": x}) for m in (lowered, model))
    assert found.shape == wanted.shape
    assert np.corrcoef(found.ravel(), wanted.ravel())[0, 1] > 0.99


@pytest.mark.parametrize(
    "tail",
    [
        "full = ConvTranspose<strides = [2, 2]>(c, v, bias)  part = Slice(full, starts, ends, axes)  y = Neg(part)",
        "full = ConvTranspose<strides = [2, 2]>(c, v)  y = Neg(full)",
        "full = ConvTranspose<strides = [2, 2]>(c, v)  n = Neg(full)  y = Slice(full, starts, ends, axes)",
        "full = ConvTranspose<strides = [2, 2]>(c, u)  part = Slice(full, starts, ends, axes)  y = Neg(part)",
        """from = Add(starts, starts)  full = ConvTranspose<strides = [2, 2]>(c, v)
           part = Slice(full, from, ends, axes)  y = Neg(part)""",
        """which = Add(axes, starts)  full = ConvTranspose<strides = [2, 2]>(c, v)
           part = Slice(full, starts, ends, which)  y = Neg(part)""",
    ],
    ids=["a bias", "not cropped", "read by another", "a computed kernel", "computed starts", "computed axes"],
)
def test_transposed_convolutions_that_stay(tail: str) -> None:
    bounds = {key: np.array(value) for key, value in CROP.items()}
    tensors = TENSORS | {"v": TENSORS["w2"], "bias": np.ones(16, np.float32)} | bounds
    body = f"u = Sin(v)  c = {CONV}(x, w)  {tail}"
    assert "full" not in candidates(GraphView(small.written(body, tensors, [1, 4, 9, 11])))


def test_a_part_that_may_end_beyond_a_transposed_convolution_s_result() -> None:
    """Of images of any size the first 17 rows: a small one has fewer, and the convolutions make some."""
    body = f"c = {CONV}(x, w)  full = ConvTranspose<strides = [2, 2]>(c, v)  y = Slice(full, starts, ends, axes)"
    tensors = TENSORS | {"v": TENSORS["w2"]} | {key: np.array(value) for key, value in CROP.items()}
    assert "full" in candidates(GraphView(small.written(body, tensors, [1, 4, 9, 11])))
    assert "full" not in candidates(GraphView(small.written(body, tensors, SHAPE)))


def test_computed_ends_are_trusted_of_the_adjoint_s_own_alone() -> None:
    """A network's own part to the size of the image would have a row more than its ConvTranspose of kernel 1 gives."""
    body = (
        f"c = {CONV}(x, w)  full = ConvTranspose<strides = [2, 2], kernel_shape = [1, 1]>(c, v)  "
        "size = Shape<start = 2>(x)  twice = Add(size, size)  part = Slice(full, starts, twice, axes)  y = Neg(part)"
    )
    tensors = TENSORS | {"v": small.weights(16, 16, 1, 1), "starts": np.array([0, 0]), "axes": np.array([2, 3])}
    model = small.written(body, tensors, SHAPE)
    assert "full" not in candidates(GraphView(model))
    x = drawn(1, 4, 9, 11)
    lowered, _ = rewrite(GraphView(model), schemes_of(model, x))
    (found,), (wanted,) = (session(m).run(None, {"x": x}) for m in (lowered, model))
    assert found.shape == wanted.shape == (1, 16, 17, 21)
    for node in model.graph.node:
        node.name = f"{ADJOINT}{node.name}"
    assert "full" in candidates(GraphView(model))


@pytest.mark.parametrize(
    ("op", "given", "steep"),
    [
        ("HardSigmoid", {"alpha": 1e30, "beta": -1.0}, True),
        ("HardSigmoid", {"alpha": 1e20, "beta": 0.0}, True),
        ("HardSigmoid", {"alpha": 1e20, "beta": 0.25}, False),
        ("HardSigmoid", {"alpha": 1e20}, False),
        ("HardSigmoid", {"alpha": 1e20, "beta": -1.5}, False),
        ("HardSigmoid", {"alpha": 1e19, "beta": 0.0}, False),
        ("HardSigmoid", {"beta": 0.0}, False),
        ("Gemm", {"alpha": 1e30, "beta": 0.0}, False),
    ],
)
def test_a_step_at_zero_is_a_steep_hard_sigmoid(op: str, given: dict[str, float], steep: bool) -> None:
    """With a beta above 0, zero itself would be above zero."""
    assert is_steep(helper.make_node(op, ["x"], ["y"], **given)) is steep


def test_a_convolution_along_one_axis_stays_in_floats() -> None:
    """Even where its input is integers that were moved into rows."""
    x = drawn(1, 4, 9, 11)
    body = f"c = {CONV}(x, w)  r = Relu(c)  f = Reshape(r, rows)  e = Conv(f, row)  y = Sin(e)"
    model = small.written(body, TENSORS | {"row": small.weights(16, 16, 3)}, SHAPE)
    _, origins = rewrite(GraphView(model), schemes_of(model, x))
    assert set(origins.values()) == {"c"}
