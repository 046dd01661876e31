"""Adjoints of reductions: y = f(x) over some axes; dy is repeated along them again."""

from __future__ import annotations

import numpy as np
import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect.emit import Ints, as_number, reduce, shape_of, unsqueeze

from .shapes import rank_is_known


def _supports(ctx: Context) -> str | None:
    name = ctx.input(1)
    if name and ctx.value(name) is None:
        return "axes that are computed"
    return rank_is_known(ctx)


def axes_of(ctx: Context) -> list[int]:
    """The axes that the node reduces, from the attribute (before opset 13 or 18) or the input."""
    rank = ctx.rank(ctx.node.input[0])
    given = ctx.value(ctx.input(1)) if ctx.input(1) else ctx.attrs.get("axes")
    if given is None or len(given) == 0:
        return [] if ctx.attrs.get("noop_with_empty_axes", 0) else list(range(rank))
    return sorted(int(a) % rank for a in given)


def _kept(ctx: Context, y: str, axes: Ints, role: str) -> str:
    """`y` or its gradient with the reduced axes, of size 1, in place."""
    return y if ctx.attrs.get("keepdims", 1) or not axes else unsqueeze(ctx, y, axes, role)


def _repeated(ctx: Context, grad: str, role: str = "dx") -> str:
    """`grad`, with size 1 along the reduced axes, in x's shape."""
    return ctx.op("Expand", grad, shape_of(ctx, ctx.node.input[0], "x_shape"), role=role)


@adjoint("ReduceSum", supports=_supports)
def reduce_sum(ctx: Context, _node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = sum x;  dx = dy."""
    return [_repeated(ctx, _kept(ctx, grad_y, axes_of(ctx), "kept"))]


@adjoint("ReduceMean", supports=_supports)
def reduce_mean(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = sum x / n;  dx = dy / n."""
    share = ctx.op("Div", grad_y, count(ctx, node.input[0], axes_of(ctx)), role="share")
    return [_repeated(ctx, _kept(ctx, share, axes_of(ctx), "kept"))]


def count(ctx: Context, x: str, axes: list[int]) -> str:
    """How many numbers of `x` meet along `axes`, in x's dtype; static where the shape is."""
    dims = [(ctx.shape(x) or [])[a] for a in axes]
    static = [d for d in dims if isinstance(d, int)]
    if len(static) == len(dims):
        return ctx.const(np.prod(static, dtype=np.int64), "count", like=x)
    sizes = ctx.op("Gather", ctx.op("Shape", x, role="sizes"), ctx.int64s(axes, "count_axes"), role="reduced_sizes")
    product = ctx.op("ReduceProd", sizes, role="count_int", keepdims=0)
    return as_number(ctx, product, x, "count")


@adjoint("CumSum")
def cumulative_sum(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y_i = sum of x_j for j <= i;  dx_j = sum of dy_i for i >= j: the same from the other end.

    `exclusive` leaves j = i out of both.
    """
    turned, exclusive = 1 - ctx.attrs.get("reverse", 0), ctx.attrs.get("exclusive", 0)
    return [ctx.op("CumSum", grad_y, node.input[1], role="dx", reverse=turned, exclusive=exclusive)]


@adjoint("ReduceMax", "ReduceMin", supports=_supports)
def reduce_extreme(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = max x (or min);  dx = dy [x = y] / #[x = y]: shared between those that tie, as in torch.amax."""
    x, axes = node.input[0], axes_of(ctx)
    hit = ctx.op("Equal", x, _kept(ctx, node.output[0], axes, "y_kept"), role="hit")
    mask = as_number(ctx, hit, x, "mask")
    if not axes:
        return [grad_y]
    share = ctx.op("Div", _kept(ctx, grad_y, axes, "kept"), reduce(ctx, "ReduceSum", mask, axes, "hits"), role="share")
    return [ctx.op("Mul", mask, share, role="dx")]


@adjoint("ReduceL1", supports=_supports)
def reduce_l1(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = sum |x|;  dx = dy sign(x)."""
    sign = ctx.op("Sign", node.input[0], role="sign")
    return [ctx.op("Mul", sign, _kept(ctx, grad_y, axes_of(ctx), "kept"), role="dx")]


@adjoint("ReduceL2", supports=_supports)
def reduce_l2(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = sqrt(sum x^2);  dx = dy x / y, and 0 where y = 0 (a zero vector's norm has a kink there)."""
    x, axes = node.input[0], axes_of(ctx)
    share = ctx.op("Mul", grad_y, safe_inverse(ctx, node.output[0], x), role="share")
    return [ctx.op("Mul", x, _kept(ctx, share, axes, "kept"), role="dx")]


def safe_inverse(ctx: Context, norm: str, like: str) -> str:
    """1 / n, and 0 where n = 0, of n >= 0."""
    sign = ctx.op("Sign", norm, role="nonzero")
    missing = ctx.op("Sub", ctx.const(1, "unit", like=like), sign, role="is_zero")
    return ctx.op("Div", sign, ctx.op("Add", norm, missing, role="norm_or_one"), role="inverse_norm")


@adjoint("ReduceSumSquare", supports=_supports)
def reduce_sum_square(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = sum x^2;  dx = 2 x dy."""
    double = ctx.op("Mul", grad_y, ctx.const(2, "two", like=node.input[0]), role="double")
    return [ctx.op("Mul", node.input[0], _kept(ctx, double, axes_of(ctx), "kept"), role="dx")]


@adjoint("ReduceLogSumExp", supports=_supports)
def reduce_log_sum_exp(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = log sum e^x;  dx = dy e^(x - y)."""
    x, axes = node.input[0], axes_of(ctx)
    below = ctx.op("Sub", x, _kept(ctx, node.output[0], axes, "y_kept"), role="below")
    return [ctx.op("Mul", ctx.op("Exp", below, role="softmax"), _kept(ctx, grad_y, axes, "kept"), role="dx")]


@adjoint("GlobalAveragePool", supports=rank_is_known)
def global_average_pool(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = mean of x over the spatial axes;  dx = dy / (H W).   x: (N, C, H, W), y: (N, C, 1, 1)"""
    x = node.input[0]
    share = ctx.op("Div", grad_y, count(ctx, x, list(range(2, ctx.rank(x)))), role="share")
    return [_repeated(ctx, share)]


@adjoint("GlobalMaxPool", supports=rank_is_known)
def global_max_pool(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = max of x over the spatial axes;  dx = dy at the FIRST place in raster order that attains it.

    x: (N, C, H, W) -> (N, C, H W); ArgMax gives the first place.
    """
    x = node.input[0]
    flat = ctx.op("Reshape", x, ctx.int64s([0, 0, -1], "flat_shape"), role="flat")
    first = ctx.op("ArgMax", flat, role="first", axis=2, keepdims=1)  # (N, C, 1)
    length = ctx.op("ReduceProd", ctx.op("Slice", ctx.op("Shape", flat, role="flat_sizes"), *(
        ctx.int64s([i], f"last_{i}") for i in (2, 3, 0)
    ), role="last_size"), role="length", keepdims=0)  # fmt: skip
    zero, one = ctx.const(np.array(0, np.int64), "zero"), ctx.const(np.array(1, np.int64), "one")
    places = ctx.op("Range", zero, length, one, role="places")
    mask = as_number(ctx, ctx.op("Equal", places, first, role="hit"), x, "mask_flat")
    mask = ctx.op("Reshape", mask, shape_of(ctx, x, "x_shape"), role="mask")
    return [ctx.op("Mul", mask, grad_y, role="dx")]
