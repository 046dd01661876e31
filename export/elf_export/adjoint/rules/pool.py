"""Adjoints of pooling."""

from __future__ import annotations

import math

import numpy as np
import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect import OPS
from elf_export.dialect.emit import concat_ints
from elf_export.dialect.spatial import begin_pads, crop_spatial, pad_spatial, spatial_shape
from elf_export.graph.windows import Window, window_of

from .shapes import rank_is_known


def _pool_supports(ctx: Context) -> str | None:
    if ctx.attrs.get("storage_order", 0):
        return "storage_order=1"
    return rank_is_known(ctx)


@adjoint("MaxPool", supports=_pool_supports)
def max_pool(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y_m = max over the places i of window m of x_i;  dx_i = sum of dy_m over the windows m in which i is the FIRST
    place in raster order with x_i = y_m.

    Places are those of `dialect.ops`, in the image, not in its padding.  The choice among places that tie is torch's.
    Ties at zero are masked by the ReLU before; above zero they are common: flat regions of an image that was strongly
    JPEG-compressed give exactly equal values.
    """
    return [ctx.own("MaxPoolGrad", grad_y, node.output[0], node.input[0], role="dx", **_window_attributes(ctx))]


@adjoint("AveragePool", supports=rank_is_known)
def average_pool(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y_m = 1/c_m sum over the places i of window m of x_i;  dx_i = sum of dy_m / c_m over the windows m that hold i.

    c_m is the window's number of pixels, without those in the padding unless count_include_pad.
    """
    x, scale = node.input[0], ""
    window = window_of(ctx.graph, node, ctx.attrs["kernel_shape"])
    if window.padded:
        grad_y = ctx.op("Div", grad_y, _counts(ctx, node, window), role="share")
    else:
        scale = ctx.const(1 / math.prod(window.kernel), "scale", like=x)
    return [ctx.own("WindowSum", grad_y, scale, x, role="dx", **_window_attributes(ctx))]


def _window_attributes(ctx: Context) -> dict[str, object]:
    """The attributes that say where the windows are."""
    return {name: ctx.attrs[name] for name in OPS["MaxPoolGrad"].attributes if name in ctx.attrs}


def _counts(ctx: Context, node: onnx.NodeProto, window: Window) -> str:
    """(1, 1, out...): how many pixels each window averages over: a sum-pool of ones, zeros in the padding."""
    x, n = node.input[0], len(window.kernel)
    ones_shape = concat_ints(ctx, [[1, 1], spatial_shape(ctx, x, "ones_size")], "ones_shape")
    one = ctx.const(np.ones((1,) * (n + 2)), "one", like=x)
    ones = ctx.op("Expand", one, ones_shape, role="ones")
    begin = begin_pads(ctx, window, x)
    if ctx.attrs.get("count_include_pad", 0):
        # The stated padding counts; what ceil_mode adds behind it does not.
        ones = pad_spatial(ctx, ones, x, begin, window.end, "counted", fill=1)
        begin = ctx.int64s([0] * n, "counted_begin")
        spare = [s - 1 if window.ceil else 0 for s in window.strides]
    else:
        spare = [e + (s - 1 if window.ceil else 0) for e, s in zip(window.end, window.strides, strict=True)]
    ones = pad_spatial(ctx, ones, x, begin, spare, "framed")
    kernel = ctx.const(np.ones((1, 1, *window.kernel)), "count_kernel", like=x)
    counts = ctx.op(
        "Conv", ones, kernel, role="counts_full", kernel_shape=list(window.kernel),
        strides=list(window.strides), dilations=list(window.dilations),
    )  # fmt: skip
    size = spatial_shape(ctx, node.output[0], "counts_size")
    zero = ctx.int64s([0] * n, "counts_start")
    return crop_spatial(ctx, counts, zero, size, "counts", window.spatial_axes)
