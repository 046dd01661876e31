"""Adjoints of activations made of straight pieces: dx = dy * f'(x), f' being piecewise constant or linear.

Masks are products with steps where they can be, which every target has a fast form of.  At a
kink the choice is torch's for the activation of that name.
"""

from __future__ import annotations

import numpy as np
import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect.emit import as_number, between, step


@adjoint("Relu")
def relu(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = max(x, 0);  dx = dy * [y > 0].   any shape"""
    return [ctx.op("Mul", grad_y, step(ctx, node.output[0], "mask"), role="dx")]


@adjoint("LeakyRelu")
def leaky_relu(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x if x > 0 else a x;  dx = dy if x > 0 else a dy."""
    slope = ctx.const(ctx.attrs.get("alpha", 0.01), "alpha", like=node.input[0])
    scaled = ctx.op("Mul", grad_y, slope, role="scaled")
    return [ctx.op("Where", is_positive(ctx, node.input[0]), grad_y, scaled, role="dx")]


@adjoint("PRelu", inputs=None, broadcasts=True)
def p_relu(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x if x > 0 else a x;  dx = dy if x > 0 else a dy,  da = 0 if x > 0 else x dy.

    The slope a broadcasts to x.
    """
    x, slope = node.input
    positive = is_positive(ctx, x)
    dx = ctx.op("Where", positive, grad_y, ctx.op("Mul", grad_y, slope, role="scaled"), role="dx")
    if not ctx.wanted[1]:
        return [dx]
    zero = ctx.const(0, "zero", like=x)
    return [dx, ctx.op("Where", positive, zero, ctx.op("Mul", grad_y, x, role="times_x"), role="dslope")]


@adjoint("ThresholdedRelu")
def thresholded_relu(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x if x > a else 0;  dx = dy [x > a]."""
    x = node.input[0]
    above = ctx.op("Greater", x, ctx.const(ctx.attrs.get("alpha", 1.0), "alpha", like=x), role="above")
    return [ctx.op("Mul", grad_y, as_number(ctx, above, x, "mask"), role="dx")]


@adjoint("Clip")
def clip(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = min(max(x, lo), hi);  dx = dy [lo < y < hi].   lo, hi: () or absent

    Both ends get zero, as in torch's relu6 and hardtanh (its clamp passes the gradient there).
    """
    low, high = _bound(ctx, 1, -np.inf), _bound(ctx, 2, np.inf)
    if not low and not high:
        return [grad_y]
    return [ctx.op("Mul", grad_y, between(ctx, low, high, node.output[0], "mask"), role="dx")]


def _bound(ctx: Context, index: int, nothing: float) -> str:
    """Name of a Clip's bound; empty if it is absent, or a constant of the value that bounds nothing."""
    name = ctx.input(index)
    value = ctx.value(name)
    return "" if value is not None and (value == nothing).all() else name


@adjoint("HardSigmoid")
def hard_sigmoid(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = max(0, min(1, a x + b));  dx = a dy [0 < y < 1]."""
    slope = ctx.const(ctx.attrs.get("alpha", 0.2), "alpha", like=node.input[0])
    mask = _inside_unit(ctx, node.output[0], node.input[0])
    return [ctx.op("Mul", ctx.op("Mul", grad_y, slope, role="scaled"), mask, role="dx")]


@adjoint("HardSwish", since_opset=14)
def hard_swish(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x h with h = max(0, min(1, x/6 + 1/2));  dx = dy (h + x/6 [0 < h < 1])."""
    x = node.input[0]
    sixth = ctx.op("Mul", x, ctx.const(1 / 6, "one_sixth", like=x), role="x_over_6")
    shifted = ctx.op("Add", sixth, ctx.const(0.5, "half", like=x), role="shifted")
    bounds = (ctx.const(value, f"gate_{value}", like=x) for value in (0, 1))
    gate = ctx.op("Clip", shifted, *bounds, role="gate")
    slope = ctx.op("Mul", sixth, _inside_unit(ctx, gate, x), role="gate_slope")
    return [ctx.op("Mul", grad_y, ctx.op("Add", gate, slope, role="derivative"), role="dx")]


def is_positive(ctx: Context, x: str) -> str:
    """[x > 0] as a boolean."""
    return ctx.op("Greater", x, ctx.const(0, "none", like=x), role="positive")


def _inside_unit(ctx: Context, h: str, like: str) -> str:
    """[0 < h < 1]."""
    zero, one = (ctx.const(value, f"bound_{value}", like=like) for value in (0, 1))
    return between(ctx, zero, one, h, "inside")
