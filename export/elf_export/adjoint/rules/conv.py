"""Adjoints of convolutions."""

from __future__ import annotations

import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect.spatial import crop_spatial, spatial_shape


def _conv_supports(ctx: Context) -> str | None:
    shape = ctx.shape(ctx.node.input[1])
    if shape is None or not all(isinstance(d, int) for d in shape):
        return "the kernel's shape must be static"
    return None


@adjoint("Conv", supports=_conv_supports)
def conv(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y_m = sum over offsets t of W_t x_i + b,  i = s m + d t - p;   dx_i = sum of W_t^T dy_m over all m and t that
    meet at i.

    W: (O, I/g, k...), W_t = W[:, :, t], group by group; x: (N, I, in...), 0 outside; y: (N, O, out...); strides s,
    dilations d, padding in front p.
    """
    x, weight = node.input[:2]
    return [ctx.own("ConvGrad", grad_y, weight, x, role="dx", **ctx.attrs)]


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
    """y is the transposed convolution of x by W, and b;  dx the convolution of dy by W, of the same strides and pads.

    W: (I, O/g, k...), which is the layout that Conv reads as (its outputs, its inputs / g, k...).
    Of h pixels of x along an axis y has s (h - 1) + e + r - p - q, with the kernel's extent e = (k - 1) d + 1, the
    padding p in front and q behind, and r < max(s, d) the output_padding.  The convolution has h + floor(r / s)
    windows, of which the first h are meant.
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
