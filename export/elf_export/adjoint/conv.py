"""Adjoints of convolutions."""

from __future__ import annotations

import numpy as np
import onnx

from ..graph import Array
from .geometry import Window, begin_pads, crop_spatial, spatial_shape, window_of
from .registry import Context, Gradients, adjoint


def _conv_supports(ctx: Context) -> str | None:
    shape = ctx.shape(ctx.node.input[1])
    if shape is None or not all(isinstance(d, int) for d in shape):
        return "the kernel's shape must be static"
    if len(ctx.wanted) > 1 and any(ctx.wanted[1:]):
        return "the kernel or bias depends on the image"
    return None


@adjoint("Conv", since_opset=11, supports=_conv_supports)
def conv(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = W * x + b;  dx = W^T * dy.   W: (O, I/g, k...), x: (N, I, ...), y: (N, O, ...)

    Stride 1: again a convolution, the kernel flipped and its channels transposed, pads k - 1 - p; it stays in
    the blocked layout in which ONNX Runtime convolves, and ConvTranspose does not.
    Otherwise ConvTranspose, whose kernel layout (C_in = O, C_out/g = I/g) is W's own.  Up to s - 1 trailing
    pixels were never covered by a window: output_padding makes room for them, and what is beyond x is cut.
    """
    kernel_shape = [d for d in ctx.shape(node.input[1]) or [] if isinstance(d, int)]
    window = window_of(ctx, kernel_shape[2:])
    group = ctx.attrs.get("group", 1)
    weight = ctx.value(node.input[1])
    stride_one = all(s == 1 for s in window.strides)
    fits = window.begin is not None and all(
        e - 1 >= p for e, p in zip(window.extent * 2, window.begin + window.end, strict=True)
    )
    if stride_one and fits and weight is not None:
        assert window.begin is not None
        pads = [e - 1 - p for e, p in zip(window.extent * 2, window.begin + window.end, strict=True)]
        dx = ctx.op(
            "Conv", grad_y, ctx.const(flipped(weight, group), "weight"), role="dx",
            kernel_shape=list(window.kernel), pads=pads, dilations=list(window.dilations), group=group,
        )  # fmt: skip
    else:
        dx = _transposed(ctx, node, grad_y, window, group)
    return [dx, *([None] * (len(node.input) - 1))]


def flipped(weight: Array, group: int) -> Array:
    """Kernel of the adjoint of a stride-1 convolution: (O, I/g, k...) -> (I, O/g, k...), flipped along each k."""
    out, per_group, *kernel = weight.shape
    swapped = weight.reshape(group, out // group, per_group, *kernel).swapaxes(1, 2)
    joined = swapped.reshape(group * per_group, out // group, *kernel)
    return np.ascontiguousarray(np.flip(joined, tuple(range(2, joined.ndim))))


def _transposed(ctx: Context, node: onnx.NodeProto, grad_y: str, window: Window, group: int) -> str:
    x, n = node.input[0], len(window.kernel)
    # Padding in front that is static is cut by ConvTranspose itself, otherwise by the Slice.
    pads = [*(window.begin or (0,) * n), *(0,) * n]
    full = ctx.op(
        "ConvTranspose", grad_y, node.input[1], role="dx_full",
        kernel_shape=list(window.kernel), strides=list(window.strides), dilations=list(window.dilations),
        group=group, pads=pads, output_padding=[s - 1 for s in window.strides],
    )  # fmt: skip
    start = ctx.int64s([0] * n, "dx_start") if window.begin is not None else begin_pads(ctx, window, x)
    return crop_spatial(ctx, full, start, spatial_shape(ctx, x, "x_size"), "dx", window.spatial_axes)
