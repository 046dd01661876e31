"""The tests of the rules can fail: a wrong rule of every op is caught, and likely mistakes too."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from onnx.shape_inference import InferenceError
from onnxruntime.capi.onnxruntime_pybind11_state import Fail

from elf_export.adjoint import Context, Gradients, registry, supported_ops
from elf_export.adjoint.rules import pool
from elf_export.graph.windows import Window
from elf_export.lowering import plain, scatter

from . import test_pool, test_quantization
from .every_case import CASES, named
from .oracles import Case, check

pytestmark = pytest.mark.torch

CAUGHT = (AssertionError, InferenceError, Fail)  # wrong numbers, or a graph that does not fit together
HAVE_THEIR_OWN_TESTS = {"QuantizeLinear", "DequantizeLinear"}


def replace_rule(monkeypatch: pytest.MonkeyPatch, op: str, wrap: Callable[[Any], Any]) -> None:
    """Put ``wrap(rule)`` in the place of an op's rule."""
    entry = registry._RULES[op]
    monkeypatch.setitem(registry._RULES, op, dataclasses.replace(entry, rule=wrap(entry.rule)))


def off_by_a_thousandth(rule: Any) -> Any:
    def wrong(ctx: Context, node: Any, *grads: str | None) -> Gradients:
        def off(grad: str | None) -> str | None:
            factor = ctx.const(1.001, "wrong", like=node.input[0] if node.op_type != "Where" else node.input[1])
            return grad and ctx.op("Mul", grad, factor, role="wrongly")

        return [off(grad) for grad in rule(ctx, node, *grads)]

    return wrong


def test_every_rule_has_a_row() -> None:
    assert set(supported_ops()) == {case.op for case in CASES} | HAVE_THEIR_OWN_TESTS


@pytest.mark.parametrize("op", sorted(set(supported_ops()) - HAVE_THEIR_OWN_TESTS))
def test_a_rule_that_is_off_by_a_thousandth_is_caught(op: str, monkeypatch: pytest.MonkeyPatch) -> None:
    case = next(case for case in CASES if case.op == op)
    check(case, case.opsets[0])
    replace_rule(monkeypatch, op, off_by_a_thousandth)
    with pytest.raises(AssertionError, match=r"torch\.autograd: error"):
        check(case, case.opsets[0])


def test_the_two_other_oracles_catch_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """With torch's gradient made to agree with the wrong rule."""
    from . import oracles

    right = oracles.by_torch

    def wrong(case: Case, *args: Any) -> Any:
        y, seed, grads = right(case, *args)
        return y, seed, {name: 1.001 * grad for name, grad in grads.items()}

    monkeypatch.setattr(oracles, "by_torch", wrong)
    for name, words in (("pads_1", "<Ax, s>"), ("tanh", "differences give")):
        replace_rule(monkeypatch, named(name).op, off_by_a_thousandth)
        with pytest.raises(AssertionError, match=words):
            check(named(name), 17)


def skip_flip(_rule: Any) -> Any:
    def wrong(ctx: Context, node: Any, grad: str) -> Gradients:
        weight = ctx.value(node.input[1])
        assert weight is not None
        swapped = np.ascontiguousarray(weight.swapaxes(0, 1))
        return [ctx.op("Conv", grad, ctx.const(swapped, "weight"), pads=[1, 1, 1, 1])]

    return wrong


def all_ties(_rule: Any) -> Any:
    """Resize and Equal: every place that ties gets the gradient."""

    def wrong(ctx: Context, node: Any, grad: str) -> Gradients:
        scales = ctx.const(np.array([1, 1, 2, 2], np.float32), "scales")

        def spread(v: str, role: str) -> str:
            up = ctx.op("Resize", v, "", scales, role=role, coordinate_transformation_mode="asymmetric",
                        nearest_mode="floor")  # fmt: skip
            size = ctx.op("Shape", node.input[0], role="x_size")
            lack = ctx.op("Sub", size, ctx.op("Shape", up, role="up_size"), role="lack")
            pads = ctx.op("Concat", ctx.int64s([0] * 4, "none"), lack, role="pads", axis=0)
            return ctx.op("Pad", up, pads, role="padded")

        hit = ctx.op("Equal", spread(node.output[0], "y_up"), node.input[0], role="hit")
        return [ctx.op("Mul", spread(grad, "dy_up"), ctx.op("Cast", hit, role="mask", to=ctx.graph.elem_type("x")))]

    return wrong


def zero_is_positive(_rule: Any) -> Any:
    """A Relu mask by the input's sign alone: negative inputs turn the gradient round."""
    return lambda ctx, node, grad: [ctx.op("Mul", grad, ctx.op("Sign", node.input[0]))]


FAMILIES: list[tuple[str, str, Callable[[Any], Any]]] = [
    ("pads_1", "Conv", skip_flip),
    ("relu", "Relu", zero_is_positive),
    ("sub", "Sub", lambda _: lambda _ctx, _node, grad: [grad, grad]),
    ("mul", "Mul", lambda _: lambda ctx, node, grad: [ctx.op("Mul", grad, v) for v in node.input]),
    (
        "transpose",
        "Transpose",
        lambda _: lambda ctx, _node, grad: [ctx.op("Transpose", grad, perm=ctx.attrs["perm"])],
    ),
    ("concat", "Concat", lambda rule: lambda ctx, node, grad: [rule(ctx, node, grad)[i] for i in (2, 1, 0)]),
    ("reflect", "Pad", lambda rule: lambda ctx, node, grad: _as_constant(rule, ctx, node, grad)),
    ("softmax", "Softmax", lambda _: lambda ctx, node, grad: [ctx.op("Mul", grad, node.output[0])]),
    ("instance", "InstanceNormalization", lambda _: lambda _ctx, _node, grad: [grad]),
    (
        "depth_to_space_crd",
        "DepthToSpace",
        lambda _: lambda ctx, _node, grad: [ctx.op("SpaceToDepth", grad, blocksize=2)],
    ),
    ("matmul_attention", "MatMul", lambda _: lambda _ctx, node, _grad: [node.input[0], node.input[1]]),
]


def _as_constant(rule: Any, ctx: Context, node: Any, grad: str) -> Gradients:
    ctx.attrs["mode"] = "constant"
    result: Gradients = rule(ctx, node, grad)
    return result


@pytest.mark.parametrize(("name", "op", "wrap"), FAMILIES, ids=[f[1] for f in FAMILIES])
def test_a_likely_mistake_is_caught(
    name: str, op: str, wrap: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    replace_rule(monkeypatch, op, wrap)
    with pytest.raises(CAUGHT):
        check(named(name), 17 if 17 in named(name).opsets else named(name).opsets[-1])


def test_ties_that_all_get_the_gradient_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    attrs = {"kernel_shape": [2, 2], "strides": [2, 2]}
    test_pool.test_a_tie_goes_to_the_first_in_raster_order(attrs)
    replace_rule(monkeypatch, "MaxPool", all_ties)
    check(named("max_vgg_odd"), 17)  # without ties nothing is wrong
    with pytest.raises(CAUGHT):
        test_pool.test_a_tie_goes_to_the_first_in_raster_order(attrs)


def test_padding_that_is_forgotten_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (plain, pool, scatter):
        right = module.begin_pads

        def wrong(ctx: Context, window: Window, x: str, right: Any = right) -> str:
            return right(ctx, dataclasses.replace(window, begin=(0,) * len(window.kernel)), x)  # type: ignore[no-any-return]

        monkeypatch.setattr(module, "begin_pads", wrong)
    for name in ("max_xception", "average_xception", "same_upper_7x10_k3_s2"):
        with pytest.raises(CAUGHT):
            check(named(name), 17)


def test_mistakes_in_the_plain_form_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the fast form has none: off by a thousandth, the first place left out, a share twice."""
    scatter_ = plain.scatter

    def times(form: Any, factor: float) -> Any:
        return lambda site: site.op("Mul", form(site), site.const(factor, "factor", like=site.like))

    def without_first(site: Any, x: str, pieces: dict[Any, str], *others: Any) -> str:
        return scatter_(site, x, dict(list(pieces.items())[1:]), *others)

    changes: list[tuple[str, Any, str]] = [
        ("conv_grad", times(plain.conv_grad, 1.001), "pads_1"),
        ("scatter", without_first, "max_vgg"),
        ("window_sum", times(plain.window_sum, 2.0), "average_vgg"),
    ]
    for name, wrong, case in changes:
        with monkeypatch.context() as patch:
            patch.setattr(plain, name, wrong)
            with pytest.raises(AssertionError, match=r"plain: torch\.autograd"):
                check(named(case), 17)


def test_counting_the_padding_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def count_all(rule: Any) -> Any:
        def wrong(ctx: Context, node: Any, grad: str) -> Any:
            ctx.attrs["count_include_pad"] = 1
            return rule(ctx, node, grad)

        return wrong

    replace_rule(monkeypatch, "AveragePool", count_all)
    with pytest.raises(CAUGHT):
        check(named("average_xception"), 17)


def test_forgotten_unbroadcasting_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    from elf_export.adjoint import broadcast

    monkeypatch.setattr(broadcast, "unbroadcast", lambda _ctx, _sizes, grad, *_: grad)
    with pytest.raises(CAUGHT):
        check(named("add_row"), 17)


def test_saturation_that_is_forgotten_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    replace_rule(monkeypatch, "QuantizeLinear", lambda _: lambda _ctx, _node, grad: [grad])
    with pytest.raises(CAUGHT):
        test_quantization.test_per_tensor(13, 0, 255, np.uint8)
