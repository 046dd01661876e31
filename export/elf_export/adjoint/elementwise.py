"""Adjoints of elementwise arithmetic.  The engine undoes broadcasting."""

from __future__ import annotations

import onnx

from .registry import Context, Gradients, adjoint


@adjoint("Add", since_opset=7)
def add(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = a + b;  da = dy, db = dy."""
    return [grad_y, grad_y]


@adjoint("Identity")
def identity(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x;  dx = dy."""
    return [grad_y]
