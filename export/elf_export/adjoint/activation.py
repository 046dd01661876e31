"""Adjoints of pointwise activations: dx = dy * f'(x)."""

from __future__ import annotations

import onnx

from .registry import Context, Gradients, adjoint


@adjoint("Relu", since_opset=6)
def relu(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = max(x, 0);  dx = dy * [y > 0] = dy * sign(y), since y >= 0.   any shape

    Sign and Mul cost a quarter of Greater and Where in ONNX Runtime, and keep to one dtype.
    """
    return [ctx.op("Mul", grad_y, ctx.op("Sign", node.output[0], role="mask"), role="dx")]
