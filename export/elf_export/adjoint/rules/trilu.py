"""Adjoint of Trilu, the triangle of a matrix: linear, and its own adjoint."""

from __future__ import annotations

import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint


@adjoint("Trilu", since_opset=14)
def trilu(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x on and above diagonal k (on and below it if upper=0), 0 elsewhere;  dx = dy there.   x, y: (..., H, W)"""
    return [ctx.op("Trilu", grad_y, *node.input[1:], role="dx", upper=ctx.attrs.get("upper"))]
