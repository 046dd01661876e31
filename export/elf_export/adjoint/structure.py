"""Adjoints of ops that only move values, and the ops that pass no gradient on."""

from __future__ import annotations

import onnx

from .registry import Context, Gradients, adjoint, no_gradient

no_gradient(
    "Shape", "Size", "NonZero", "ArgMax", "ArgMin", "Equal", "Greater", "GreaterOrEqual", "Less", "LessOrEqual",
    "And", "Or", "Not", "Xor", "Floor", "Ceil", "Round", "Sign", "IsNaN", "IsInf", "OneHot", "Range",
    "ConstantOfShape", "Constant", "RandomNormal", "RandomUniform", "EyeLike",
)  # fmt: skip


def _concat_supports(ctx: Context) -> str | None:
    axis = ctx.attrs.get("axis", 1)
    for name in ctx.node.input:
        shape = ctx.shape(name)
        if shape is None or not isinstance(shape[axis], int):
            return f"the size of {name!r} along axis {axis} must be static"
    return None


@adjoint("Concat", since_opset=4, supports=_concat_supports)
def concat(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = [x_1, x_2, ...] along an axis;  dx_i = the i-th piece of dy."""
    axis = ctx.attrs["axis"]
    grads: list[str | None] = []
    start = 0
    for name, wanted in zip(node.input, ctx.wanted, strict=True):
        shape = ctx.shape(name)
        assert shape is not None
        size = shape[axis]
        assert isinstance(size, int)
        grads.append(slice_axes(ctx, grad_y, [start], [start + size], [axis], role="piece") if wanted else None)
        start += size
    return grads


def slice_axes(
    ctx: Context, x: str, starts: list[int], ends: list[int], axes: list[int], role: str, steps: list[int] | None = None
) -> str:
    """Slice with constant bounds, in the form of the graph's opset (attributes before 10)."""
    if ctx.opset < 10:
        assert steps is None, "steps need opset 10"
        return ctx.op("Slice", x, role=role, starts=starts, ends=ends, axes=axes)
    bounds = [ctx.int64s(v, f"{role}_{what}") for v, what in ((starts, "starts"), (ends, "ends"), (axes, "axes"))]
    if steps is not None:
        bounds.append(ctx.int64s(steps, f"{role}_steps"))
    return ctx.op("Slice", x, *bounds, role=role)
