"""One-op models and the three oracles that every adjoint rule is held against.

    (a) torch.autograd in float64, on the op written in torch;
    (b) <A x, s> = <x, A' s> where the op is linear (affine: with A x = f(x) - f(0));
    (c) central differences of <s, f(x)> along one random direction.

The emitted graph runs in ONNX Runtime in float32 and in ONNX's reference evaluator in float64, with symbolic
and with static sizes.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import helper, numpy_helper

from elf_export.lowering import TARGETS

from .runs import Array, one_graph, run_ort, run_reference, with_adjoint

Runner = Callable[[onnx.ModelProto, Mapping[str, Array]], list[Array]]

BASE_SEED = int(os.environ.get("ELF_TEST_SEED", "0"))
NEVER = 99  # an opset
STEP = 1e-6  # of the central differences, in float64; 1e-2 in float32


@dataclass(frozen=True)
class Case:
    """A row: one node, its inputs, what it is in torch, and how exact its adjoint must be.

    Attributes
    ----------
    inputs : name -> shape
        Inputs that get a gradient, first among the node's inputs unless `order` says otherwise.
    constants : name -> array
        Inputs that are initializers; floats are written in the model's dtype.
    torch : function of the inputs' tensors (float64), then of the constants'; returns the first output
    computed : names of constants
        Those are inputs of the graph instead, known when it runs only.
    order : the node's inputs, "" for one that is left out
    dynamic_from : int
        First opset at which the graph can have symbolic sizes.
    static_axes : axes of every input whose size is stated in any case
    reference_from : int
        First opset at which ONNX's reference evaluator computes the node as ONNX Runtime and torch do; before
        that it runs in float32 only.
    tolerance32, tolerance64 : largest error over the largest expected absolute value
    draw : how to draw an input: (rng, shape) -> array
    """

    name: str
    op: str
    inputs: Mapping[str, Sequence[int]]
    torch: Callable[..., torch.Tensor]
    attrs: Mapping[str, Any] = field(default_factory=dict)
    constants: Mapping[str, Any] = field(default_factory=dict)
    computed: Collection[str] = ()
    order: Sequence[str] | None = None
    opsets: Sequence[int] = (11, 13, 17, 20)
    linear: bool = False
    differences: bool = True
    dynamic_from: int = 11
    static_axes: Sequence[int] = ()
    reference_from: int = 0
    single_only: bool = False  # the op's schema has no float64
    outputs: int = 1
    tolerance32: float = 1e-5
    tolerance64: float = 1e-12
    draw: Callable[[np.random.Generator, Sequence[int]], Array] = lambda rng, shape: rng.standard_normal(shape)

    def model(self, opset: int, dynamic: bool, dtype: type[np.floating[Any]]) -> onnx.ModelProto:
        elem = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
        infos = [
            helper.make_tensor_value_info(
                name, elem,
                [f"{name}_{i}" if dynamic and i not in self.static_axes else d for i, d in enumerate(shape)],
            )
            for name, shape in self.inputs.items()
        ]  # fmt: skip
        values = {name: _as(value, dtype) for name, value in self.constants.items()}
        tensors = [numpy_helper.from_array(v, name) for name, v in values.items() if name not in self.computed]
        infos.extend(
            helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(values[name].dtype), values[name].shape)
            for name in self.computed
        )
        order = self.order if self.order is not None else [*self.inputs, *self.constants]
        outs = ["y", *(f"y{i}" for i in range(1, self.outputs))]
        node = helper.make_node(self.op, list(order), outs, name="node", **self.attrs)
        return one_graph([node], infos, tensors, opset, elem)


def check(case: Case, opset: int) -> None:
    """Hold one row against all its oracles; raise AssertionError, naming the seed, where it fails."""
    seed = zlib.crc32(f"{BASE_SEED} {case.name} {opset}".encode())
    rng = np.random.default_rng(seed)
    values = {name: case.draw(rng, shape) for name, shape in case.inputs.items()}
    expected_y, weights, expected = by_torch(case, values, rng)
    where = f"{case.name}, opset {opset}, ELF_TEST_SEED={BASE_SEED} (seed {seed})"
    for dynamic in (False, True) if opset >= case.dynamic_from else (False,):
        for dtype in (np.float32, np.float64) if opset >= case.reference_from else (np.float32,):
            model = case.model(opset, dynamic, dtype)
            feed = {name: value.astype(dtype) for name, value in {**values, "seed": weights}.items()}
            feed.update((name, _as(case.constants[name], dtype)) for name in case.computed)
            run = run_ort if dtype is np.float32 else run_reference
            tolerance = case.tolerance32 if dtype is np.float32 else case.tolerance64
            for wrt in case.inputs:
                label = f"{where}, d{wrt}, {dtype.__name__}, {'dynamic' if dynamic else 'static'}"
                both = with_adjoint(model, wrt)
                assert_standard(both, types=not (case.single_only and dtype is np.float64))
                y, dx = run(both, feed)
                assert y.shape == expected_y.shape, f"{label}: torch and ONNX disagree on y's shape"
                close(y, expected_y, max(tolerance, 1e-6), f"{label}: torch and ONNX disagree on y")
                assert dx.dtype == dtype, f"{label}: gradient of dtype {dx.dtype}"
                assert dx.shape == values[wrt].shape, f"{label}: gradient of shape {dx.shape}"
                close(dx, expected[wrt], tolerance, f"{label}: torch.autograd")
                if opset in (min(case.opsets), min(case.opsets, key=lambda other: abs(other - 17))):
                    in_other_forms(model, wrt, feed, run, expected[wrt], tolerance, label)
                if not dynamic:
                    continue
                if case.linear:
                    by_linearity(model, run, feed, wrt, dx, tolerance, label)
                if case.differences and dtype is np.float64:
                    by_differences(model, run, feed, wrt, dx, rng, STEP, 1e-6, label)
    if case.differences and opset < case.reference_from:
        model = case.model(opset, False, np.float32)
        feed = {name: value.astype(np.float32) for name, value in {**values, "seed": weights}.items()}
        for wrt in case.inputs:
            _, dx = run_ort(with_adjoint(model, wrt), feed)
            by_differences(model, run_ort, feed, wrt, dx, rng, 1e-2, 2e-2, f"{where}, d{wrt}, float32")


def in_other_forms(
    model: onnx.ModelProto, wrt: str, feed: Mapping[str, Array], run: Runner, expected: Array, tolerance: float,
    label: str,
) -> None:  # fmt: skip
    """The other lowerings, and where one differs from the fast one the operations of `dialect` themselves, in numpy."""
    fast, forms = with_adjoint(model, wrt).SerializeToString(), {}
    for lowering in set(TARGETS) - {"fast"}:
        forms[lowering] = with_adjoint(model, wrt, lowering=lowering)
        assert_standard(forms[lowering], types=False)
    forms = {name: form for name, form in forms.items() if form.SerializeToString() != fast}
    for name, form in forms.items():
        close(run(form, feed)[1], expected, tolerance, f"{label}, {name}: torch.autograd")
    if forms and run is run_reference:
        close(run(with_adjoint(model, wrt, lowering=None), feed)[1], expected, tolerance, f"{label}: in numpy")


def by_torch(
    case: Case, values: Mapping[str, Array], rng: np.random.Generator
) -> tuple[Array, Array, dict[str, Array]]:
    """Oracle (a): y, a random seed of its shape, and the gradient of <seed, y> for every input."""
    tensors = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in values.values()]
    constants = [torch.from_numpy(np.array(_as(value, np.float64))) for value in case.constants.values()]
    y = case.torch(*tensors, *constants)
    seed = torch.from_numpy(np.asarray(rng.standard_normal(tuple(y.shape))))
    grads = torch.autograd.grad(y, tensors, seed)
    return y.detach().numpy(), seed.numpy(), {n: g.numpy() for n, g in zip(values, grads, strict=True)}


def by_linearity(
    model: onnx.ModelProto,
    run: Runner,
    feed: Mapping[str, Array],
    wrt: str,
    dx: Array,
    tolerance: float,
    label: str,
) -> None:
    """Oracle (b): <A x, s> = <x, A' s>."""
    inputs = {k: v for k, v in feed.items() if k != "seed"}
    at_zero = {**inputs, wrt: np.zeros_like(inputs[wrt])}
    ax = run(model, inputs)[0].astype(np.float64) - run(model, at_zero)[0]
    left, right = np.vdot(ax, feed["seed"]), np.vdot(inputs[wrt].astype(np.float64), dx)
    scale = np.linalg.norm(ax) * np.linalg.norm(feed["seed"])
    assert abs(left - right) <= 10 * tolerance * scale, f"{label}: <Ax, s> = {left}, <x, A's> = {right}"


def by_differences(
    model: onnx.ModelProto, run: Runner, feed: Mapping[str, Array], wrt: str, dx: Array,
    rng: np.random.Generator, step: float, tolerance: float, label: str,
) -> None:  # fmt: skip
    """Oracle (c): (<s, f(x + h v)> - <s, f(x - h v)>) / 2h = <dx, v>."""
    inputs = {k: v for k, v in feed.items() if k != "seed"}
    x = inputs[wrt]
    v = rng.standard_normal(x.shape).astype(x.dtype)
    sides = [run(model, {**inputs, wrt: x + sign * x.dtype.type(step) * v})[0] for sign in (1, -1)]
    slope = np.vdot(sides[0].astype(np.float64) - sides[1], feed["seed"]) / (2 * step)
    along = np.vdot(dx.astype(np.float64), v)
    scale = max(np.linalg.norm(dx) * np.linalg.norm(v), 1e-3)
    assert abs(slope - along) <= tolerance * scale, f"{label}: differences give {slope}, the adjoint {along}"


def close(got: Array, expected: Array, tolerance: float, label: str) -> None:
    """Largest error at most `tolerance` times the largest expected value."""
    scale = max(float(np.abs(expected).max(initial=0)), 1e-3)
    error = float(np.abs(got.astype(np.float64) - expected).max(initial=0)) / scale
    assert error <= tolerance, f"{label}: error {error:.2e} of the largest value, allowed {tolerance:.0e}"


def assert_standard(model: onnx.ModelProto, types: bool = True, names: bool = True) -> None:
    """Only ai.onnx ops, in the form of the model's opset; names pair forward and backward."""
    onnx.checker.check_model(model, full_check=types)
    for node in model.graph.node:
        assert node.domain in ("", "ai.onnx")
        assert not names or node.name.startswith(("node", "adj/", "result"))


def rows(cases: Sequence[Case]) -> pytest.MarkDecorator:
    """Parametrise a test by (case, opset)."""
    return pytest.mark.parametrize(
        ("case", "opset"),
        [pytest.param(case, opset, id=f"{case.name}-{opset}") for case in cases for opset in case.opsets],
    )


def _as(value: Any, dtype: type[np.floating[Any]]) -> Array:
    """Floats in `dtype`; integers as they are.  A float32 array that must stay one is marked by `Fixed`."""
    if isinstance(value, Fixed):
        return value.array
    array = np.asarray(value)
    return array.astype(dtype) if np.issubdtype(array.dtype, np.floating) else array


@dataclass(frozen=True)
class Fixed:
    """A constant that keeps its dtype in a float64 model (the scales of Resize)."""

    array: Array


def positive(rng: np.random.Generator, shape: Sequence[int]) -> Array:
    """Draws in [0.5, 2.5)."""
    return rng.random(shape) * 2 + 0.5


def apart(rng: np.random.Generator, shape: Sequence[int]) -> Array:
    """Draws 0.1 apart from one another and from 0: float32 differences step over no kink."""
    values = 0.1 * np.arange(1, 1 + np.prod(shape)) * rng.choice([-1, 1], int(np.prod(shape)))
    return np.asarray(rng.permutation(values).reshape(shape))


def wide(rng: np.random.Generator, shape: Sequence[int]) -> Array:
    """Draws of standard deviation 4: both ends of activations that saturate."""
    return rng.standard_normal(shape) * 4
