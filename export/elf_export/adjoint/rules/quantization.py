"""Adjoints of QuantizeLinear and DequantizeLinear: straight through, zero where the integers saturate."""

from __future__ import annotations

import numpy as np
import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.graph.graph import Array


def _quantize_supports(ctx: Context) -> str | None:
    node = ctx.node
    zero = ctx.input(2)
    if ctx.value(node.input[1]) is None or (zero and ctx.value(zero) is None):
        return "scale and zero point must be constants"
    if ctx.attrs.get("block_size", 0):
        return "blocked quantisation"
    if not np.issubdtype(ctx.dtype(node.output[0]), np.integer):
        return "quantisation to a type other than 8- or 16-bit integers"
    return None if ctx.graph.rank(node.input[0]) is not None else "unknown rank of the input"


@adjoint("QuantizeLinear", supports=_quantize_supports, through_integers=True)
def quantize(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """q = saturate(round(x / s) + z);  dx = dq [q_min <= round(x / s) + z <= q_max].

    dq is in units of s q: the gradient of what the integers stand for, which a pair Quantize, Dequantize
    hands through.  The zero is no detail: a quantiser that drops a Relu before unsigned integers relies on
    the saturation in its place, and its mask would be lost.
    """
    x = node.input[0]
    scale = _per_axis(ctx, node.input[1])
    zero = _per_axis(ctx, node.input[2]) if ctx.input(2) else np.zeros(1)
    limits = np.iinfo(ctx.dtype(node.output[0]))
    low, high = (limits.min - zero - 0.5) * scale, (limits.max - zero + 0.5) * scale
    capped = ctx.op(
        "Min",
        ctx.op("Max", x, ctx.const(low, "low", like=x), role="raised"),
        ctx.const(high, "high", like=x),
        role="capped",
    )
    inside = ctx.op("Equal", x, capped, role="inside")
    return [ctx.op("Where", inside, grad_y, ctx.const(0, "zero", like=x), role="dx")]


def _dequantize_supports(ctx: Context) -> str | None:
    source = _source(ctx)
    if source is None or ctx.value(ctx.node.input[1]) is None or ctx.value(source.input[1]) is None:
        return "its input must come straight from a QuantizeLinear, both scales being constants"
    return _quantize_supports(Context(ctx.graph, source))


@adjoint("DequantizeLinear", supports=_dequantize_supports, through_integers=True)
def dequantize(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """x' = (q - z) s';  dq = dy s' / s in units of s q, s being the scale that q was made with.

    Mostly s = s', and dq = dy.
    """
    source = _source(ctx)
    assert source is not None
    ratio = _per_axis(ctx, node.input[1]) / _per_axis(Context(ctx.graph, source), source.input[1])
    if np.all(ratio == 1):
        return [grad_y]
    return [ctx.op("Mul", grad_y, ctx.const(ratio, "scale_ratio", like=source.input[0]), role="dq")]


def _source(ctx: Context) -> onnx.NodeProto | None:
    """The QuantizeLinear that made the node's input."""
    found = (node for node in ctx.graph.nodes if ctx.node.input[0] in node.output)
    node = next(found, None)
    return node if node is not None and node.op_type == "QuantizeLinear" else None


def _per_axis(ctx: Context, name: str) -> Array:
    """A scale or zero point in float64, shaped to broadcast along the node's axis."""
    value = ctx.value(name)
    assert value is not None
    wide = value.astype(np.float64)
    if wide.ndim == 0 or wide.size == 1:
        return wide.reshape(())
    rank = ctx.rank(ctx.node.input[0])
    return wide.reshape([-1] + [1] * (rank - 1 - ctx.attrs.get("axis", 1) % rank))
