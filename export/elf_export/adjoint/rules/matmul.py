"""Adjoints of matrix products."""

from __future__ import annotations

import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint


def _matmul_supports(ctx: Context) -> str | None:
    for name in ctx.node.input:
        rank = ctx.graph.rank(name)
        if rank is None or rank < 2:
            return f"{name!r} must have a known rank of at least 2"
    return None


@adjoint("MatMul", inputs=None, supports=_matmul_supports, broadcasts=True, core_axes=2)
def matmul(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """Y = A B;  dA = dY B^T, dB = A^T dY.   A: (..., m, k), B: (..., k, n); the axes in front broadcast"""
    a, b = node.input
    da = ctx.op("MatMul", grad_y, _turned(ctx, b, "b_turned"), role="da") if ctx.wanted[0] else None
    db = ctx.op("MatMul", _turned(ctx, a, "a_turned"), grad_y, role="db") if ctx.wanted[1] else None
    return [da, db]


def _turned(ctx: Context, x: str, role: str) -> str:
    """(..., m, n) -> (..., n, m)."""
    rank = ctx.rank(x)
    return ctx.op("Transpose", x, role=role, perm=[*range(rank - 2), rank - 1, rank - 2])


@adjoint("Gemm", inputs=2)
def gemm(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """Y = alpha A' B' + beta C, A' = A or A^T, B' = B or B^T.   A': (m, k), B': (k, n)

    dA' = alpha dY B'^T,  dB' = alpha A'^T dY;  turned round again where A or B was.
    """
    a, b = node.input[0], node.input[1]
    turn_a, turn_b = ctx.attrs.get("transA", 0), ctx.attrs.get("transB", 0)
    alpha = ctx.attrs.get("alpha", 1.0)
    da = db = None
    if ctx.wanted[0]:
        first, second, turns = (b, grad_y, (turn_b, 1)) if turn_a else (grad_y, b, (0, 1 - turn_b))
        da = ctx.op("Gemm", first, second, role="da", alpha=alpha, transA=turns[0], transB=turns[1])
    if ctx.wanted[1]:
        first, second, turns = (grad_y, a, (1, turn_a)) if turn_b else (a, grad_y, (1 - turn_a, 0))
        db = ctx.op("Gemm", first, second, role="db", alpha=alpha, transA=turns[0], transB=turns[1])
    return [da, db]
