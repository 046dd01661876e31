"""Steps become masks in integers, exactly zero or one, or stay in floats."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from onnx import TensorProto

from elf_export.graph.graph import Graph, GraphView
from elf_export.precision.int8.rewrite import rewrite
from elf_export.precision.int8.scheme import reaching
from export import small_models as small

from .rounded_networks import rounded_values, session, with_values
from .written import CONV, SHAPE, STEP, TENSORS, drawn, schemes_of


@pytest.mark.parametrize("moved", ["Identity(r)", "Reshape(r, rows)", "Transpose<perm = [0, 2, 3, 1]>(r)"])
def test_the_sign_of_what_is_never_negative_is_its_integers_clipped(moved: str) -> None:
    x = drawn(1, 4, 9, 11)
    model = small.written(f"c = {CONV}(x, w)  r = Relu(c)  f = {moved}  m = {STEP}(f)  y = Neg(m)", TENSORS, SHAPE)
    lowered, _ = rewrite(GraphView(model), schemes_of(model, x))
    found = with_values(lowered, ["f/q", "m/q", "y"], x)
    assert 0.3 < (found["f/q"] > 0).mean() < 0.7
    np.testing.assert_array_equal(found["m/q"], np.minimum(found["f/q"], 1))
    np.testing.assert_array_equal(found["y"], -1.0 * (found["f/q"] > 0))


def test_a_mask_that_the_graph_gives_out_is_in_floats() -> None:
    x = drawn(1, 4, 9, 11)
    model = small.written(f"c = {CONV}(x, w)  r = Relu(c)  y = {STEP}(r)", TENSORS, SHAPE)
    found = with_values(rewrite(GraphView(model), schemes_of(model, x))[0], ["r/rounded", "y"], x)
    np.testing.assert_array_equal(found["y"], np.sign(found["r/rounded"]))


def test_one_minus_a_mask_that_the_graph_gives_out_is_in_floats() -> None:
    x = drawn(1, 4, 9, 11)
    body = f"c = {CONV}(x, w)  r = Relu(c)  m = {STEP}(r)  y = elf.Complement(m)"
    model = small.written(body, TENSORS, SHAPE)
    found = with_values(rewrite(GraphView(model), schemes_of(model, x))[0], ["r/q", "y"], x)
    np.testing.assert_allclose(found["y"], found["r/q"] == 0, atol=1e-6)


@pytest.mark.parametrize(
    ("of", "reader", "free"), [("m", "Mul(k, half)", True), ("m", "Sin(k)", False), ("r", "Mul(k, half)", False)]
)
def test_one_minus_a_mask_is_no_operator_where_it_is_a_factor(of: str, reader: str, free: bool) -> None:
    x, half = drawn(1, 4, 9, 11), {"half": np.float32(0.5)}
    behind = f"m = {STEP}(r)  k = elf.Complement({of})  y = {reader}"
    model = small.written(f"c = {CONV}(x, w)  r = Relu(c)  {behind}", TENSORS | half, SHAPE)
    schemes = schemes_of(model, x)
    lowered, _ = rewrite(GraphView(model), schemes)
    assert any(node.op_type == "Complement" for node in lowered.graph.node) == (not free)
    found = with_values(lowered, ["r/q", "y"], x)
    floats = small.written(f"r = Identity(x)  {behind}", half, ["N", 16, "H", "W"])
    wanted = with_values(floats, ["y"], np.float32(schemes["r"].scale) * found["r/q"])["y"]
    np.testing.assert_allclose(found["y"], wanted, rtol=0, atol=1e-6 * np.abs(wanted).max())


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
        (f"r = Relu(x)  c = {CONV}(r, w)  m = {STEP}(r)", "r", np.sign),
        (f"s = Sin(x)  c = {CONV}(s, w)  d = Conv<group = 4>(s, differences)  m = {STEP}(d)", "s",
         lambda s: np.diff(s) > 0),
        (f"r = Clip(x, zero, top)  c = {CONV}(r, w)  m = elf.Between(zero, top, r)", "r", lambda r: (r > 0) & (r < 1)),
        # Not rounded at all.
        (f"c = {CONV}(x, w)  r = Clip(x, zero, top)  m = elf.Between(zero, top, r)", "r", lambda r: (r > 0) & (r < 1)),
        # Bounds that are not zero and the highest level.
        (f"{CLIPPED}  m = elf.Between(zero, two, r)", "r/rounded", lambda r: r > 0),
        (f"{CLIPPED}  m = elf.Between(quarter, top, r)", "r/rounded", lambda r: (r > 0.25) & (r < 1)),
        (f"{CLIPPED}  m = elf.Between(zero, tops, r)", "r/rounded", lambda r: (r > 0) & (r < TENSORS["tops"])),
        (f"{CLIPPED}  h = Cos(r)  m = elf.Between(zero, h, r)", "r/rounded", lambda r: (r > 0) & (r < np.cos(r))),
    ],
)  # fmt: skip
def test_what_is_no_mask_of_rounded_values_is_computed_as_it_stands(
    body: str, source: str, wanted: Callable[[np.ndarray], np.ndarray]
) -> None:
    x = drawn(1, 4, 9, 11)
    x[..., 4:8] *= 1e-3  # less than half a level
    model = small.written(f"{body}  y = Neg(m)", TENSORS | {"quarter": np.float32(0.25)}, SHAPE)
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
    kinds = [graph.elem_type(node.input[0]) for node in graph.nodes if node.output[0] in ("m", "m/q")]
    assert kinds == [TensorProto.UINT8 if moved else TensorProto.FLOAT]
    part = small.written(f"y = {op}", tensors, [1, 16, "H", "W"])
    part.graph.input[0].name = "r"
    found = with_values(lowered, ["r/q", "y"], x)
    rounded = found["r/q"] * np.float32(rounded_values(lowered)["r"].scale)
    (after,) = session(part).run(None, {"r": rounded})
    np.testing.assert_allclose(found["y"], np.sin(after), atol=1e-6)
