"""Adjoints of normalisation layers."""

from __future__ import annotations

import numpy as np
import onnx

from .registry import Context, Gradients, adjoint


def _bn_supports(ctx: Context) -> str | None:
    if ctx.attrs.get("training_mode", 0):
        return "training_mode=1; export the model for inference"
    if any(ctx.value(ctx.node.input[i]) is None for i in (1, 4)):
        return "scale and variance must be constants"
    return None if ctx.graph.rank(ctx.node.input[0]) is not None else "unknown rank"


@adjoint("BatchNormalization", since_opset=9, supports=_bn_supports)
def batch_normalization(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = (x - mean) / sqrt(var + eps) * scale + bias;  dx = dy * scale / sqrt(var + eps).   x: (N, C, ...)"""
    scale, variance = ctx.value(node.input[1]), ctx.value(node.input[4])
    assert scale is not None
    assert variance is not None
    factor = scale.astype(np.float64) / np.sqrt(variance.astype(np.float64) + ctx.attrs.get("epsilon", 1e-5))
    channels = [-1] + [1] * (ctx.rank(node.input[0]) - 2)  # (C,) -> (C, 1, 1)
    weight = ctx.const(factor.reshape(channels), "factor", like=node.input[0])
    return [ctx.op("Mul", grad_y, weight, role="dx"), None, None, None, None]
