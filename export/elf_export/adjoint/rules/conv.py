"""Adjoints of convolutions."""

from __future__ import annotations

import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.adjoint.spatial import begin_pads, crop_spatial, flipped, spatial_shape
from elf_export.graph.windows import Window, window_of

from . import strided


def _conv_supports(ctx: Context) -> str | None:
    shape = ctx.shape(ctx.node.input[1])
    if shape is None or not all(isinstance(d, int) for d in shape):
        return "the kernel's shape must be static"
    return None


@adjoint("Conv", supports=_conv_supports)
def conv(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = W * x + b;  dx = W^T * dy.   W: (O, I/g, k...), x: (N, I, ...), y: (N, O, ...)

    Stride 1: again a convolution, the kernel flipped and its channels transposed, pads k - 1 - p; it stays in
    the blocked layout in which ONNX Runtime convolves, and ConvTranspose does not.
    Strided, to an image's few channels or depthwise: a convolution for each phase of dx, see `strided`.
    Otherwise ConvTranspose, whose kernel layout (C_in = O, C_out/g = I/g) is W's own.  Up to s - 1 trailing
    pixels were never covered by a window: output_padding makes room for them, and what is beyond x is cut.
    """
    kernel_shape = [d for d in ctx.shape(node.input[1]) or [] if isinstance(d, int)]
    window = window_of(ctx.graph, node, kernel_shape[2:])
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
        return [dx]
    if weight is not None and strided.suits(ctx, window, weight, group):
        return [strided.conv(ctx, grad_y, window, weight, group)]
    return [_transposed(ctx, node, grad_y, window, group)]


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


def _conv_transpose_supports(ctx: Context) -> str | None:
    if reason := _conv_supports(ctx):
        return reason
    if "output_shape" in ctx.attrs:
        return "output_shape; state pads and output_padding instead"
    if ctx.attrs.get("auto_pad", "NOTSET").startswith("SAME") and min(_same_surplus(ctx)) < 0:
        return "auto_pad SAME with a stride beyond the kernel"
    return None


@adjoint("ConvTranspose", supports=_conv_transpose_supports)
def conv_transpose(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = W^T * x + b;  dx = W * dy, a convolution with the same kernel, strides and pads.

    W: (I, O/g, k...), which is the layout that Conv reads as (its outputs, its inputs / g, k...).
    Along an axis y has s (h - 1) + e + r - p - q pixels, e being the kernel's extent and r < max(s, d) the
    output_padding; the convolution's windows number h + floor(r / s), of which the first h are meant.
    """
    shape = [d for d in ctx.shape(node.input[1]) or [] if isinstance(d, int)]
    n = len(shape) - 2
    strides, rest = ctx.attrs.get("strides", [1] * n), ctx.attrs.get("output_padding", [0] * n)
    pads = ctx.attrs.get("pads", [0] * 2 * n)
    auto = ctx.attrs.get("auto_pad", "NOTSET")
    if auto == "VALID":
        pads = [0] * 2 * n
    elif auto != "NOTSET":
        small = [t // 2 for t in _same_surplus(ctx)]
        large = [t - t // 2 for t in _same_surplus(ctx)]
        pads = [*small, *large] if auto == "SAME_UPPER" else [*large, *small]
    dx = ctx.op(
        "Conv", grad_y, node.input[1], role="dx", kernel_shape=shape[2:], strides=strides, pads=pads,
        dilations=ctx.attrs.get("dilations", [1] * n), group=ctx.attrs.get("group", 1),
    )  # fmt: skip
    if any(r >= s for r, s in zip(rest, strides, strict=True)):
        size = spatial_shape(ctx, node.input[0], "x_size")
        dx = crop_spatial(ctx, dx, ctx.int64s([0] * n, "dx_start"), size, "dx_cut", list(range(2, 2 + n)))
    return [dx]


def _same_surplus(ctx: Context) -> list[int]:
    """What auto_pad SAME cuts per axis, so that y is s times as large as x: e + r - s."""
    kernel = [d for d in (ctx.shape(ctx.node.input[1]) or [])[2:] if isinstance(d, int)]
    ones, zeros = [1] * len(kernel), [0] * len(kernel)
    dilations, strides = ctx.attrs.get("dilations", ones), ctx.attrs.get("strides", ones)
    rest = ctx.attrs.get("output_padding", zeros)
    return [(k - 1) * d + 1 + r - s for k, d, r, s in zip(kernel, dilations, rest, strides, strict=True)]
