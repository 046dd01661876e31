"""Adjoints of smooth activations: dx = dy * f'(x), written with y = f(x) where that saves work."""

from __future__ import annotations

import math

import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint

from .activation import is_positive

SELU_ALPHA, SELU_GAMMA = 1.67326319217681884765625, 1.05070102214813232421875  # ONNX's defaults


@adjoint("Sigmoid")
def sigmoid(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = 1 / (1 + e^-x);  dx = dy y (1 - y)."""
    return [ctx.op("Mul", grad_y, _logistic_slope(ctx, node.output[0], node.input[0]), role="dx")]


@adjoint("Tanh")
def tanh(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = tanh x;  dx = dy (1 - y^2)."""
    return [ctx.op("Mul", grad_y, _one_minus_square(ctx, node.output[0], node.input[0]), role="dx")]


@adjoint("Elu", "Selu")
def elu(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = g x if x > 0 else g a (e^x - 1);  dx = g dy if x > 0 else dy (y + g a).   Elu: g = 1"""
    selu = node.op_type == "Selu"
    x, y = node.input[0], node.output[0]
    gamma = ctx.attrs.get("gamma", SELU_GAMMA) if selu else 1.0
    alpha = ctx.attrs.get("alpha", SELU_ALPHA if selu else 1.0)
    exponential = ctx.op("Add", y, ctx.const(gamma * alpha, "gamma_alpha", like=x), role="exponential")
    gain = ctx.const(gamma, "gamma", like=x)
    return [ctx.op("Mul", grad_y, ctx.op("Where", is_positive(ctx, x), gain, exponential, role="slope"), role="dx")]


@adjoint("Celu", since_opset=12)
def celu(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x if x > 0 else a (e^(x/a) - 1);  dx = dy if x > 0 else dy (y/a + 1)."""
    x, y = node.input[0], node.output[0]
    one = ctx.const(1, "one", like=x)
    scaled = ctx.op("Mul", y, ctx.const(1 / ctx.attrs.get("alpha", 1.0), "over_alpha", like=x), role="scaled")
    exponential = ctx.op("Add", scaled, one, role="exponential")
    return [ctx.op("Mul", grad_y, ctx.op("Where", is_positive(ctx, x), one, exponential, role="slope"), role="dx")]


@adjoint("Softplus")
def softplus(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = log(1 + e^x);  dx = dy sigmoid(x)."""
    return [ctx.op("Mul", grad_y, ctx.op("Sigmoid", node.input[0], role="slope"), role="dx")]


@adjoint("Softsign")
def softsign(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x / (1 + |x|);  dx = dy / (1 + |x|)^2."""
    x = node.input[0]
    reach = ctx.op("Add", ctx.op("Abs", x, role="size"), ctx.const(1, "one", like=x), role="reach")
    return [ctx.op("Div", grad_y, ctx.op("Mul", reach, reach, role="reach_squared"), role="dx")]


@adjoint("Mish", since_opset=18)
def mish(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x t with t = tanh(softplus x);  dx = dy (t + x (1 - t^2) sigmoid(x))."""
    x = node.input[0]
    gate = ctx.op("Tanh", ctx.op("Softplus", x, role="softplus"), role="gate")
    slope = ctx.op("Mul", _one_minus_square(ctx, gate, x), ctx.op("Sigmoid", x, role="sigmoid"), role="gate_slope")
    return [_gated(ctx, grad_y, x, gate, slope)]


@adjoint("Swish", since_opset=24)
def swish(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x s with s = sigmoid(a x);  dx = dy (s + x a s (1 - s))."""
    x = node.input[0]
    alpha = ctx.const(ctx.attrs.get("alpha", 1.0), "alpha", like=x)
    gate = ctx.op("Sigmoid", ctx.op("Mul", x, alpha, role="scaled"), role="gate")
    slope = ctx.op("Mul", alpha, _logistic_slope(ctx, gate, x), role="gate_slope")
    return [_gated(ctx, grad_y, x, gate, slope)]


@adjoint("Gelu", since_opset=20)
def gelu(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x p;  dx = dy (p + x p').   With u = sqrt(2/pi) (x + c x^3), c = 0.044715:

    none: p = (1 + erf(x / sqrt 2)) / 2,  p' = exp(-x^2 / 2) / sqrt(2 pi)
    tanh: p = (1 + tanh u) / 2,           p' = (1 - tanh^2 u) / 2 * sqrt(2/pi) (1 + 3 c x^2)
    """
    x = node.input[0]
    half, one = ctx.const(0.5, "half", like=x), ctx.const(1, "one", like=x)
    square = ctx.op("Mul", x, x, role="square")

    def times(a: str, factor: float, role: str) -> str:
        return ctx.op("Mul", a, ctx.const(factor, f"{role}_factor", like=x), role=role)

    if ctx.attrs.get("approximate", "none") == "tanh":
        root, cubic = math.sqrt(2 / math.pi), 0.044715
        inner = ctx.op("Add", times(square, cubic * root, "cubic"), ctx.const(root, "root", like=x), role="inner")
        curve = ctx.op("Tanh", ctx.op("Mul", x, inner, role="u"), role="curve")
        du = times(square, 1.5 * cubic * root, "half_du_rest")
        du = ctx.op("Add", du, ctx.const(root / 2, "half_root", like=x), role="half_du")
        slope = ctx.op("Mul", _one_minus_square(ctx, curve, x), du, role="gate_slope")
    else:
        curve = ctx.op("Erf", times(x, math.sqrt(0.5), "u"), role="curve")
        bell = ctx.op("Exp", times(square, -0.5, "exponent"), role="bell")
        slope = times(bell, 1 / math.sqrt(2 * math.pi), "gate_slope")
    gate = ctx.op("Mul", half, ctx.op("Add", one, curve, role="one_plus"), role="gate")
    return [_gated(ctx, grad_y, x, gate, slope)]


@adjoint("Erf")
def erf(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = erf x;  dx = dy 2 / sqrt(pi) exp(-x^2)."""
    x = node.input[0]
    bell = ctx.op("Exp", ctx.op("Neg", ctx.op("Mul", x, x, role="square"), role="exponent"), role="bell")
    gain = ctx.const(2 / math.sqrt(math.pi), "gain", like=x)
    return [ctx.op("Mul", ctx.op("Mul", grad_y, gain, role="scaled"), bell, role="dx")]


def _gated(ctx: Context, grad_y: str, x: str, gate: str, slope: str) -> str:
    """dx of y = x g(x):  dy (g + x g')."""
    return ctx.op("Mul", grad_y, ctx.op("Add", gate, ctx.op("Mul", x, slope), role="derivative"), role="dx")


def _logistic_slope(ctx: Context, s: str, like: str) -> str:
    """s (1 - s), the derivative of the logistic function in terms of its value."""
    return ctx.op("Mul", s, ctx.op("Sub", ctx.const(1, "unit", like=like), s, role="rest"), role="logistic_slope")


def _one_minus_square(ctx: Context, t: str, like: str) -> str:
    """1 - t^2, the derivative of tanh in terms of its value."""
    return ctx.op("Sub", ctx.const(1, "unit", like=like), ctx.op("Mul", t, t, role="t_squared"), role="tanh_slope")
