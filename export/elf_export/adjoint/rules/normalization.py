"""Adjoints of normalisation layers."""

from __future__ import annotations

import math

import numpy as np
import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect.emit import mean, reduce, shape_of
from elf_export.graph.response import Response

from .reduction import safe_inverse
from .shapes import rank_is_known


def _bn_supports(ctx: Context) -> str | None:
    if ctx.attrs.get("training_mode", 0):
        return "training_mode=1; export the model for inference"
    return rank_is_known(ctx)


@adjoint("BatchNormalization", supports=_bn_supports)
def batch_normalization(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = (x - mean) / sqrt(var + eps) * scale + bias;  dx = dy scale / sqrt(var + eps).   x: (N, C, ...)"""
    x, scale, variance = node.input[0], node.input[1], node.input[4]
    s, v, epsilon = ctx.value(scale), ctx.value(variance), ctx.attrs.get("epsilon", 1e-5)
    channels = [-1] + [1] * (ctx.rank(x) - 2)  # (C,) -> (C, 1, 1)
    if s is not None and v is not None:
        factor = s.astype(np.float64) / np.sqrt(v.astype(np.float64) + epsilon)
        weight = ctx.const(factor.reshape(channels), "factor", like=x)
    else:
        shifted = ctx.op("Add", variance, ctx.const(epsilon, "epsilon", like=x), role="shifted_variance")
        flat = ctx.op("Div", scale, ctx.op("Sqrt", shifted, role="deviation"), role="flat_factor")
        weight = ctx.op("Reshape", flat, ctx.int64s(channels, "channels"), role="factor")
    return [ctx.op("Mul", grad_y, weight, role="dx")]


def standardized_adjoint(ctx: Context, x: str, grad: str, axes: list[int], like: str) -> str:
    """v = (x - m) / d, d = sqrt(var + eps);  dx = (dv - mean dv - v mean(dv v)) / d.

    m and var are x's mean and biased variance, and all means are over `axes`.  `grad` is dv, `like` of x's type.
    """
    centred = ctx.op("Sub", x, mean(ctx, x, axes, "mean"), role="centred")
    variance = mean(ctx, ctx.op("Mul", centred, centred, role="squared"), axes, "variance")
    epsilon = ctx.const(ctx.attrs.get("epsilon", 1e-5), "epsilon", like=like)
    deviation = ctx.op("Sqrt", ctx.op("Add", variance, epsilon, role="shifted_variance"), role="deviation")
    v = ctx.op("Div", centred, deviation, role="standardized")
    along = ctx.op("Mul", v, mean(ctx, ctx.op("Mul", grad, v, role="dv_v"), axes, "along"), role="along_v")
    rest = ctx.op(
        "Sub", ctx.op("Sub", grad, mean(ctx, grad, axes, "dv_mean"), role="dv_centred"), along, role="dv_rest"
    )
    return ctx.op("Div", rest, deviation, role="dx")


@adjoint("InstanceNormalization", supports=rank_is_known)
def instance_normalization(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = scale v + bias, v = x standardised over its spatial axes;  dv = scale dy, dx as `standardized_adjoint` says.

    x: (N, C, ...)
    """
    x, scale = node.input[:2]
    rank = ctx.rank(x)
    per_channel = ctx.op("Reshape", scale, ctx.int64s([-1] + [1] * (rank - 2), "channels"), role="scale")
    grad = ctx.op("Mul", grad_y, per_channel, role="dv")
    return [standardized_adjoint(ctx, x, grad, list(range(2, rank)), x)]


@adjoint("LayerNormalization", since_opset=17, supports=rank_is_known)
def layer_normalization(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = scale v + bias, v = x standardised over `axis` and all axes behind it;  dv = scale dy.

    With d the deviation, dx = (dv - mean dv - v mean(dv v)) / d, means over these axes.   x: any shape
    """
    x, scale = node.input[:2]
    rank = ctx.rank(x)
    axes = list(range(ctx.attrs.get("axis", -1) % rank, rank))
    return [standardized_adjoint(ctx, x, ctx.op("Mul", grad_y, scale, role="dv"), axes, x)]


@adjoint("GroupNormalization", since_opset=21, supports=rank_is_known)
def group_normalization(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = scale v + bias, v = x standardised over each of G groups of channels;  dv = scale dy.

    x: (N, C, ...) -> (N, G, (C/G) ...);  scale: (C,).   The op of opset 18 to 20 was withdrawn.
    """
    x, scale = node.input[:2]
    ones = ctx.int64s([-1] + [1] * (ctx.rank(x) - 2), "channels")
    grad = ctx.op("Mul", grad_y, ctx.op("Reshape", scale, ones, role="scale"), role="dv")
    grouped = ctx.int64s([0, ctx.attrs["num_groups"], -1], "grouped_shape")
    grad = ctx.op("Reshape", grad, grouped, role="dv_grouped")
    dx = standardized_adjoint(ctx, ctx.op("Reshape", x, grouped, role="x_grouped"), grad, [2], x)
    return [ctx.op("Reshape", dx, shape_of(ctx, x, "x_shape"), role="dx_ungrouped")]


@adjoint("LpNormalization", supports=rank_is_known)
def lp_normalization(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x / n, n = ||x||_p along an axis;  dx = (dy - g sum(dy y)) / n, g = y for p = 2, sign(x) for p = 1.

    Zero where n = 0: a zero vector has no direction.
    """
    x, y = node.input[0], node.output[0]
    axes = [ctx.attrs.get("axis", -1) % ctx.rank(x)]
    p = ctx.attrs.get("p", 2)
    norm = reduce(ctx, f"ReduceL{p}", x, axes, "norm")
    towards = y if p == 2 else ctx.op("Sign", x, role="sign")
    total = reduce(ctx, "ReduceSum", ctx.op("Mul", grad_y, y, role="dy_y"), axes, "total")
    rest = ctx.op("Sub", grad_y, ctx.op("Mul", towards, total, role="along"), role="rest")
    return [ctx.op("Mul", rest, safe_inverse(ctx, norm, x), role="dx")]


@adjoint("LRN")
def local_response_normalization(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x d^-b with d = k + a/n sum of x^2 over a window of n channels;   x: (N, C, ...)

    dx = dy d^-b - (2 a b / n) x W^T(dy y / d), W^T the sum over the channels whose window holds this one.
    """
    x, y = node.input[0], node.output[0]
    response = Response.of(ctx.graph, node)
    if response is None:
        return [_pooled_response(ctx, node, grad_y)]
    name = ctx.name("response")
    d = response.denominator(name)
    direct = ctx.op("Div", grad_y, response.power(d, name), role="direct")
    pull = response.pull(ctx.op("Div", ctx.op("Mul", grad_y, y, role="dy_y"), d, role="dy_y_d"), name)
    return [ctx.op("Add", direct, ctx.op("Mul", x, pull, role="indirect"), role="dx")]


def _pooled_response(ctx: Context, node: onnx.NodeProto, grad_y: str) -> str:
    """The same for any rank and an unknown number of channels: the sums by average pooling along the channels."""
    x, size = node.input[0], ctx.attrs["size"]
    alpha, beta = ctx.attrs.get("alpha", 1e-4), ctx.attrs.get("beta", 0.75)
    before, after = (size - 1) // 2, math.ceil((size - 1) / 2)

    def window_sum(v: str, reach: list[int], role: str) -> str:
        # AveragePool over (N, 1, C, ...): the portable sum along channels, whatever their number.
        rows = ctx.op("Reshape", v, ctx.op("Concat", *front, role=f"{role}_shape", axis=0), role=f"{role}_rows")
        pooled = ctx.op(
            "AveragePool", rows, role=f"{role}_mean", kernel_shape=[size, 1], pads=[reach[0], 0, reach[1], 0],
            count_include_pad=1,
        )  # fmt: skip
        return ctx.op("Reshape", pooled, shape, role=f"{role}_back")

    shape = shape_of(ctx, x, "x_shape")
    # (N, C, ...) -> (N, 1, C, the rest)
    n_c = [
        ctx.op("Slice", shape, *(ctx.int64s([i], f"dim_{a}_{i}") for i in (a, a + 1, 0)), role=f"dim_{a}")
        for a in (0, 1)
    ]
    front = [n_c[0], ctx.int64s([1], "single"), n_c[1], ctx.int64s([-1], "rest")]

    squares = window_sum(ctx.op("Mul", x, x, role="square"), [before, after], "squares")
    scaled = ctx.op("Mul", squares, ctx.const(alpha, "alpha", like=x), role="scaled")  # the mean has 1/n already
    d = ctx.op("Add", scaled, ctx.const(ctx.attrs.get("bias", 1.0), "bias", like=x), role="d")
    direct = ctx.op("Mul", grad_y, ctx.op("Pow", d, ctx.const(-beta, "minus_beta", like=x), role="gain"), role="direct")
    pull = ctx.op("Div", ctx.op("Mul", grad_y, node.output[0], role="dy_y"), d, role="pull")
    spread = window_sum(pull, [after, before], "spread")
    back = ctx.op("Mul", ctx.op("Mul", x, spread), ctx.const(2 * alpha * beta, "gain_back", like=x), role="indirect")
    return ctx.op("Sub", direct, back, role="dx")
