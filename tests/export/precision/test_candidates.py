"""What 8 bits are chosen for: which values are looked at, which steps become masks, and what photographs say."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from elf_export.adjoint.gradient import ADJOINT
from elf_export.calibration import CalibrationSet, calibration_set
from elf_export.graph.graph import Graph, GraphView
from elf_export.precision.int8.candidates import candidates, is_steep
from elf_export.precision.int8.ranges import MOST_VALUES, _sample, schemes_for
from elf_export.precision.int8.rewrite import rewrite
from elf_export.precision.int8.scheme import Scheme, fitted, reaching
from elf_runtime import InputSpec
from export import small_models as small
from helpers import textured

from .test_quantize import rounded_values, session, with_values

SHAPE = ["N", 4, "H", "W"]
CONV = "Conv<pads = [1, 1, 1, 1]>"
STEP = "HardSigmoid<alpha = 1e30, beta = -1.0>"
TENSORS = {
    "w": small.weights(16, 4, 3, 3),
    "w2": small.weights(16, 16, 3, 3, seed=1),
    "differences": np.tile(np.array([-1, 1], np.float32).reshape(1, 1, 1, 2), (4, 1, 1, 1)),
    "zero": np.float32(0),
    "top": np.float32(1),
    "two": np.float32(2),
    "tops": np.array([1, 2], np.float32).repeat(8).reshape(16, 1, 1),
    "rows": np.array([0, 16, -1]),
}


def drawn(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).standard_normal(shape).astype(np.float32)


def schemes_of(model: onnx.ModelProto, x: np.ndarray) -> dict[str, Scheme]:
    values = {"x": x} | with_values(model, [name for name in candidates(GraphView(model)) if name != "x"], x)
    return {name: fitted(values[name]) for name in candidates(GraphView(model))}


def chosen(body: str, tensors: dict[str, np.ndarray] | None = None) -> list[str]:
    return candidates(GraphView(small.written(body, TENSORS | (tensors or {}), SHAPE)))


# -- values that get a scheme ------------------------------------------------------------------------------------


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


# -- steps, as masks ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", ["Sign", STEP])
@pytest.mark.parametrize("moved", ["Identity(r)", "Reshape(r, rows)", "Transpose<perm = [0, 2, 3, 1]>(r)"])
def test_the_sign_of_what_is_never_negative_is_its_integers_clipped(step: str, moved: str) -> None:
    x = drawn(1, 4, 9, 11)
    model = small.written(f"c = {CONV}(x, w)  r = Relu(c)  f = {moved}  m = {step}(f)  y = Neg(m)", TENSORS, SHAPE)
    lowered, _ = rewrite(GraphView(model), schemes_of(model, x))
    found = with_values(lowered, ["f/q", "m/q", "y"], x)
    assert 0.3 < (found["f/q"] > 0).mean() < 0.7
    np.testing.assert_array_equal(found["m/q"], np.minimum(found["f/q"], 1))
    np.testing.assert_array_equal(found["y"], -1.0 * (found["f/q"] > 0))


def test_a_mask_that_the_graph_gives_out_is_in_floats() -> None:
    x = drawn(1, 4, 9, 11)
    model = small.written(f"c = {CONV}(x, w)  r = Relu(c)  y = Sign(r)", TENSORS, SHAPE)
    found = with_values(rewrite(GraphView(model), schemes_of(model, x))[0], ["r/rounded", "y"], x)
    np.testing.assert_array_equal(found["y"], np.sign(found["r/rounded"]))


def test_one_minus_a_mask_that_the_graph_gives_out_is_in_floats() -> None:
    x, constants = drawn(1, 4, 9, 11), {"negative": np.full((16, 1, 1, 1), -1, np.float32)}
    body = f"c = {CONV}(x, w)  r = Relu(c)  m = Sign(r)  y = Conv<group = 16>(m, negative, ones)"
    model = small.written(body, TENSORS | constants | {"ones": np.ones(16, np.float32)}, SHAPE)
    found = with_values(rewrite(GraphView(model), schemes_of(model, x))[0], ["r/q", "y"], x)
    np.testing.assert_allclose(found["y"], found["r/q"] == 0, atol=1e-6)


@pytest.mark.parametrize(
    ("rest", "reader", "free"),
    [
        ("Conv<group = 16>(m, negative, ones)", "Mul(k, half)", True),
        ("Conv<group = 16>(m, negative, halves)", "Mul(k, half)", False),
        ("Conv<group = 16>(m, twice, ones)", "Mul(k, half)", False),
        ("Conv<group = 16>(m, negative)", "Mul(k, half)", False),
        ("Conv<group = 16>(m, pairs, ones)", "Mul(k, half)", False),
        ("Conv<group = 16, strides = [2, 1]>(m, negative, ones)", "Mul(k, half)", False),
        ("Conv<group = 16, pads = [0, 1, 0, 0]>(m, negative, ones)", "Mul(k, half)", False),
        ("Conv<group = 16>(m, negative, ones)", "Sin(k)", False),
        ("Conv<group = 16>(r, negative, ones)", "Mul(k, half)", False),
    ],
)
def test_one_minus_a_mask_is_no_operator_where_it_is_a_factor(rest: str, reader: str, free: bool) -> None:
    x, of_masks = drawn(1, 4, 9, 11), {
        "negative": np.full((16, 1, 1, 1), -1, np.float32), "twice": np.full((16, 1, 1, 1), -2, np.float32),
        "pairs": np.full((16, 1, 1, 2), -1, np.float32), "ones": np.ones(16, np.float32),
        "halves": np.full(16, 0.5, np.float32), "half": np.float32(0.5),
    }  # fmt: skip
    behind = f"m = Sign(r)  k = {rest}  y = {reader}"
    model = small.written(f"c = {CONV}(x, w)  r = Relu(c)  {behind}", TENSORS | of_masks, SHAPE)
    schemes = schemes_of(model, x)
    lowered, origins = rewrite(GraphView(model), schemes)
    assert ("k" in origins) == (not free)
    found = with_values(lowered, ["r/q", "y"], x)
    floats = small.written(f"r = Identity(x)  {behind}", of_masks, ["N", 16, "H", "W"])
    wanted = with_values(floats, ["y"], np.float32(schemes["r"].scale) * found["r/q"])["y"]
    np.testing.assert_allclose(found["y"], wanted, rtol=0, atol=(1e-6 if free else 0.02) * np.abs(wanted).max())


CLIPPED = f"c = {CONV}(x, w)  r = Clip(c, zero, top)"


@pytest.mark.parametrize(
    ("body", "source", "wanted"),
    [
        (f"c = {CONV}(x, w)  r = Relu(c)  m = HardSigmoid<alpha = 0.3, beta = 0.5>(r)", "r/rounded",
         lambda r: np.clip(0.3 * r + 0.5, 0, 1)),
        (f"c = {CONV}(x, w)  m = HardSigmoid<alpha = 0.3, beta = 0.5>(c)", "c/rounded",
         lambda c: np.clip(0.3 * c + 0.5, 0, 1)),
        (f"c = {CONV}(x, w)  m = Sign(c)", "c/rounded", np.sign),
        # Rounded for a convolution, not for the step.
        (f"c = {CONV}(x, w)  m = {STEP}(x)", "x", lambda x: x > 0),
        (f"r = Relu(x)  c = {CONV}(r, w)  m = Sign(r)", "r", np.sign),
        (f"s = Sin(x)  c = {CONV}(s, w)  d = Conv<group = 4>(s, differences)  m = {STEP}(d)", "s",
         lambda s: np.diff(s) > 0),
        (f"r = Clip(x, zero, top)  c = {CONV}(r, w)  n = Sub(top, r)  p = Mul(r, n)  m = {STEP}(p)", "r",
         lambda r: (r > 0) & (r < 1)),
        # Not rounded at all.
        (f"c = {CONV}(x, w)  r = Clip(x, zero, top)  n = Sub(top, r)  p = Mul(r, n)  m = {STEP}(p)", "r",
         lambda r: (r > 0) & (r < 1)),
        # What resembles y (top - y).
        (f"{CLIPPED}  n = Sub(top, r)  p = Add(r, n)  m = {STEP}(p)", "r/rounded", np.ones_like),
        (f"{CLIPPED}  n = Add(top, r)  p = Mul(r, n)  m = {STEP}(p)", "r/rounded", lambda r: r > 0),
        (f"{CLIPPED}  h = Neg(r)  n = Sub(top, h)  p = Mul(r, n)  m = {STEP}(p)", "r/rounded", lambda r: r > 0),
        (f"{CLIPPED}  n = Sub(two, r)  p = Mul(r, n)  m = {STEP}(p)", "r/rounded", lambda r: r > 0),
        (f"{CLIPPED}  n = Sub(tops, r)  p = Mul(r, n)  m = {STEP}(p)", "r/rounded",
         lambda r: (r > 0) & (r < TENSORS["tops"])),
        (f"{CLIPPED}  h = Cos(r)  n = Sub(h, r)  p = Mul(r, n)  m = {STEP}(p)", "r/rounded",
         lambda r: (r > 0) & (r < np.cos(r))),
    ],
)  # fmt: skip
def test_what_is_no_mask_of_rounded_values_is_computed_as_it_stands(
    body: str, source: str, wanted: Callable[[np.ndarray], np.ndarray]
) -> None:
    x = drawn(1, 4, 9, 11)
    x[..., 4:8] *= 1e-3  # less than half a level
    model = small.written(f"{body}  y = Neg(m)", TENSORS, SHAPE)
    schemes = schemes_of(model, x)
    if "Clip" in body and "r" in schemes:
        schemes["r"] = reaching(1.0)
    found = with_values(rewrite(GraphView(model), schemes)[0], [source, "y"], x)
    np.testing.assert_allclose(found["y"], -1.0 * wanted(found[source]), atol=1e-6)


@pytest.mark.parametrize(
    ("op", "moved"),
    [
        ("MaxPool<kernel_shape = [2, 2], strides = [2, 2]>(r)", True),
        ("Transpose<perm = [0, 1, 3, 2]>(r)", True),
        ("Reshape(r, rows)", True),
        ("Slice(r, starts, ends, axes)", True),
        ("Pad(r, pads)", True),
        ("DepthToSpace<blocksize = 2>(r)", True),
        ("SpaceToDepth<blocksize = 2>(r)", True),
        ("Concat<axis = 2>(r, r)", True),
        ("Squeeze(r, first)", True),
        ("Unsqueeze(r, first)", True),
        ("Flatten(r)", True),
        ("Identity(r)", True),
        ("Exp(r)", False),
        ("Abs(r)", False),
    ],
)
def test_what_only_moves_values_moves_integers(op: str, moved: bool) -> None:
    x = drawn(1, 4, 8, 12)
    bounds = {"starts": [1, 2], "ends": [7, -1], "axes": [2, 3], "first": [0], "pads": [0, 0, 1, 2, 0, 0, 2, 1]}
    tensors = TENSORS | {key: np.array(value) for key, value in bounds.items()}
    model = small.written(f"c = {CONV}(x, w)  r = Relu(c)  m = {op}  y = Sin(m)", tensors, [1, 4, "H", "W"])
    lowered, _ = rewrite(GraphView(model), schemes_of(model, x))
    graph = Graph(lowered)
    kinds = [graph.elem_type(node.input[0]) for node in graph.nodes if node.op_type == re.split("[<(]", op)[0]]
    assert kinds == [TensorProto.UINT8 if moved else TensorProto.FLOAT]
    part = small.written(f"y = {op}", tensors, [1, 16, "H", "W"])
    part.graph.input[0].name = "r"
    found = with_values(lowered, ["r/q", "y"], x)
    rounded = found["r/q"] * np.float32(rounded_values(lowered)["r"].scale)
    (after,) = session(part).run(None, {"r": rounded})
    np.testing.assert_allclose(found["y"], np.sin(after), atol=1e-6)


# -- what photographs say ----------------------------------------------------------------------------------------


@pytest.fixture
def pictures(tmp_path: Path) -> CalibrationSet:
    """A dark picture, a bright one and a dark one."""
    for index, (factor, size) in enumerate([(0.2, 40), (1.0, 48), (0.3, 44)]):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.uint8(textured(size, 64, index) * factor))
    return calibration_set(tmp_path)


def test_schemes_are_fitted_to_the_values_on_all_images_at_the_working_scale(pictures: CalibrationSet) -> None:
    """The image itself, which is the graph's input, needs none."""
    model = small.written("a = Mul(x, third)  b = Sub(x, many)  y = Mul(a, b)",
                          {"third": np.float32(1 / 3), "many": np.float32(200)}, ["N", "H", "W", 3])  # fmt: skip
    spec = InputSpec(name="x", min_size=8)
    found = schemes_for(GraphView(model), ["x", "b", "a"], pictures, spec, 0.5)
    sizes = [(20, 32), (24, 32), (22, 32)]
    pixels = [cv2.imread(str(path)).astype(np.float32) for path in pictures.files]
    halves = [cv2.resize(p, (w, h), interpolation=cv2.INTER_AREA) for p, (h, w) in zip(pixels, sizes, strict=True)]
    every = np.concatenate([half.ravel() for half in halves])
    assert found.keys() == {"a", "b"}
    for name, values in (("a", every * np.float32(1 / 3)), ("b", every - 200)):
        wanted = fitted(np.append(values, np.float32(0)))
        assert found[name].zero == wanted.zero == (128 if name == "b" else 0)
        assert found[name].scale == pytest.approx(wanted.scale, rel=1e-6)


def test_a_sample_of_a_tensor_has_its_extremes() -> None:
    x = np.ones(20 * MOST_VALUES, np.float32)
    x[7], x[8] = -5.0, 9.0
    sample = _sample(x)
    assert (sample.min(), sample.max(), sample.dtype) == (-5.0, 9.0, np.float32)
    assert len(sample) < 1.1 * MOST_VALUES
    assert len(_sample(x[:MOST_VALUES])) >= MOST_VALUES
    assert _sample(x[:0]).tolist() == [0, 0]


@pytest.mark.parametrize("times", [1, 2, 3, 10, 11, 200])
def test_a_sample_sees_even_and_odd_columns_from_first_to_last(times: int) -> None:
    values = np.arange(times * MOST_VALUES, dtype=np.float32)
    sample = _sample(values.reshape(2, -1, 4))[:-2]
    assert abs((sample % 2).mean() - 0.5) < 0.01
    assert abs(sample.mean() / values.mean() - 1) < 0.01
    assert len(sample) >= 0.2 * MOST_VALUES
