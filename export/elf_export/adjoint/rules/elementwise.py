"""Adjoints of elementwise arithmetic.  All may broadcast: the engine sums over the repeated axes."""

from __future__ import annotations

import numpy as np
import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect.emit import step


@adjoint("Add", "Sum", inputs=None, broadcasts=True)
def add(_ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x_1 + x_2 + ...;  dx_i = dy."""
    return [grad_y] * len(node.input)


@adjoint("Sub", inputs=None, broadcasts=True)
def sub(ctx: Context, _node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = a - b;  da = dy, db = -dy."""
    return [grad_y, ctx.op("Neg", grad_y, role="db") if ctx.wanted[1] else None]


@adjoint("Mul", inputs=None, broadcasts=True)
def mul(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = a b;  da = dy b, db = dy a."""
    a, b = node.input
    return [
        ctx.op("Mul", grad_y, b, role="da") if ctx.wanted[0] else None,
        ctx.op("Mul", grad_y, a, role="db") if ctx.wanted[1] else None,
    ]


@adjoint("Div", inputs=None, broadcasts=True)
def div(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = a / b;  da = dy / b, db = -dy y / b."""
    da = ctx.op("Div", grad_y, node.input[1], role="da")
    if not ctx.wanted[1]:
        return [da]
    return [da, ctx.op("Neg", ctx.op("Mul", da, node.output[0], role="da_y"), role="db")]


@adjoint("Pow", inputs=None, broadcasts=True)
def power(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = a^b;  da = dy b a^(b-1),  db = dy y log a, and 0 where a <= 0 (torch: where a = 0 and b >= 0).

    The exponent may be of another type than the base, which is the type of y.
    """
    a, b = node.input
    elem = ctx.graph.elem_type(a)
    exponent = ctx.op("Cast", b, role="exponent", to=elem) if ctx.graph.elem_type(b) != elem else b
    value = ctx.value(b)
    da = db = None
    if ctx.wanted[0]:
        if value is not None and np.all(value == 2):
            slope = a  # by far the commonest, and Pow is slow
        else:
            lower = ctx.op("Sub", exponent, ctx.const(1, "one", like=a), role="lower")
            slope = ctx.op("Pow", a, lower, role="slope")
        da = ctx.op("Mul", ctx.op("Mul", grad_y, exponent, role="scaled"), slope, role="da")
    if ctx.wanted[1]:
        one = ctx.const(1, "unit", like=a)
        positive = ctx.op("Greater", a, ctx.const(0, "zero", like=a), role="positive")
        log = ctx.op("Log", ctx.op("Where", positive, a, one, role="safe"), role="log")
        db = ctx.op("Mul", ctx.op("Mul", grad_y, node.output[0], role="dy_y"), log, role="db")
    return [da, db]


@adjoint("Mean", inputs=None, broadcasts=True)
def mean(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = (x_1 + ... + x_k) / k;  dx_i = dy / k."""
    share = ctx.const(1 / len(node.input), "share", like=node.input[0])
    return [ctx.op("Mul", grad_y, share, role="dx")] * len(node.input)


@adjoint("Max", "Min", inputs=None, broadcasts=True)
def extreme(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = max_i x_i (or min);  dx_i = dy where x_i is the FIRST that attains y, else 0.

    As in max pooling the gradient is handed on until somebody takes it:
    r_1 = dy;  r_{i+1} = r_i [|y - x_i| > 0],  dx_i = r_i - r_{i+1};  the last takes what is left.
    (torch.maximum halves it between two that tie.)
    """
    y = node.output[0]
    rest: str = grad_y
    grads: list[str | None] = []
    for i, x in enumerate(node.input[:-1]):
        gap = ctx.op("Sub", y, x, role=f"gap_{i}") if node.op_type == "Max" else ctx.op("Sub", x, y, role=f"gap_{i}")
        passed = ctx.op("Mul", rest, step(ctx, gap, f"other_{i}"), role=f"passed_{i}")
        grads.append(ctx.op("Sub", rest, passed, role=f"taken_{i}") if ctx.wanted[i] else None)
        rest = passed
    return [*grads, rest]


@adjoint("Where", inputs=None, broadcasts=True)
def where(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = a if c else b;  da = dy if c else 0,  db = 0 if c else dy.   c gets none"""
    condition, a, _ = node.input
    zero = ctx.const(0, "zero", like=a)
    return [
        None,
        ctx.op("Where", condition, grad_y, zero, role="da") if ctx.wanted[1] else None,
        ctx.op("Where", condition, zero, grad_y, role="db") if ctx.wanted[2] else None,
    ]


@adjoint("Neg")
def neg(ctx: Context, _node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = -x;  dx = -dy."""
    return [ctx.op("Neg", grad_y, role="dx")]


@adjoint("Abs")
def absolute(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = |x|;  dx = dy sign(x)."""
    return [ctx.op("Mul", grad_y, ctx.op("Sign", node.input[0], role="sign"), role="dx")]


@adjoint("Reciprocal")
def reciprocal(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = 1 / x;  dx = -dy y^2."""
    y = node.output[0]
    square = ctx.op("Mul", y, y, role="square")
    return [ctx.op("Neg", ctx.op("Mul", grad_y, square, role="scaled"), role="dx")]


@adjoint("Sqrt")
def sqrt(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = sqrt x;  dx = dy / (2 y)."""
    half = ctx.op("Mul", grad_y, ctx.const(0.5, "half", like=node.input[0]), role="halved")
    return [ctx.op("Div", half, node.output[0], role="dx")]


@adjoint("Exp")
def exp(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = e^x;  dx = dy y."""
    return [ctx.op("Mul", grad_y, node.output[0], role="dx")]


@adjoint("Log")
def log(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = log x;  dx = dy / x."""
    return [ctx.op("Div", grad_y, node.input[0], role="dx")]


@adjoint("Sin", "Cos")
def sine(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = sin x;  dx = dy cos x.   y = cos x;  dx = -dy sin x."""
    other = ctx.op("Cos" if node.op_type == "Sin" else "Sin", node.input[0], role="other")
    dx = ctx.op("Mul", grad_y, other, role="scaled")
    return [dx if node.op_type == "Sin" else ctx.op("Neg", dx, role="dx")]
