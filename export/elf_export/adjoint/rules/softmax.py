"""Adjoints of Softmax and LogSoftmax."""

from __future__ import annotations

import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect.emit import reduce

from .shapes import rank_is_known


@adjoint("Softmax", supports=rank_is_known)
def softmax(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y_i = e^x_i / sum_j e^x_j;  dx = y (dy - sum_j dy_j y_j)."""
    y = node.output[0]
    weighted = ctx.op("Mul", grad_y, y, role="dy_y")
    total = reduce(ctx, "ReduceSum", weighted, _axes(ctx), "total")
    return [ctx.op("Mul", y, ctx.op("Sub", grad_y, total, role="centred"), role="dx")]


@adjoint("LogSoftmax", supports=rank_is_known)
def log_softmax(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y_i = x_i - log sum_j e^x_j;  dx = dy - e^y sum_j dy_j."""
    total = reduce(ctx, "ReduceSum", grad_y, _axes(ctx), "total")
    spread = ctx.op("Mul", ctx.op("Exp", node.output[0], role="softmax"), total, role="spread")
    return [ctx.op("Sub", grad_y, spread, role="dx")]


def _axes(ctx: Context) -> list[int]:
    """What is normalised together: one axis from opset 13 on, before that the axis and all behind it."""
    rank = ctx.rank(ctx.node.input[0])
    if ctx.opset >= 13:
        return [ctx.attrs.get("axis", -1) % rank]
    return list(range(ctx.attrs.get("axis", 1) % rank, rank))
