"""Adjoints of ops that give the same numbers another shape, order or type."""

from __future__ import annotations

import numpy as np
import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect.emit import Ints, concat_ints, reduce, shape_of, size_of, slice_axes


def rank_is_known(ctx: Context) -> str | None:
    """For `supports`: the rule needs the rank of the first input."""
    return "unknown rank of the input" if ctx.graph.rank(ctx.node.input[0]) is None else None


@adjoint("Identity")
def identity(_ctx: Context, _node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x;  dx = dy."""
    return [grad_y]


def _dropout_supports(ctx: Context) -> str | None:
    training = ctx.input(2)
    if not training:
        return None
    value = ctx.value(training)
    return None if value is not None and not value.any() else "training_mode; export the model for inference"


@adjoint("Dropout", supports=_dropout_supports)
def dropout(_ctx: Context, _node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x at inference;  dx = dy."""
    return [grad_y]


@adjoint("Cast", "CastLike")
def cast(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x in another floating type;  dx = dy in x's type.   A cast to integers stops the gradient."""
    return [ctx.op("Cast", grad_y, role="dx", to=ctx.graph.elem_type(node.input[0]))]


@adjoint("Reshape", "Flatten", "Squeeze", "Unsqueeze")
def reshape(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x in another shape;  dx = dy in x's shape."""
    return [ctx.op("Reshape", grad_y, shape_of(ctx, node.input[0], "x_shape"), role="dx")]


@adjoint("Expand", broadcasts=True)
def expand(_ctx: Context, _node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x repeated along axes of size 1;  dx = dy, which the engine sums over those."""
    return [grad_y]


def _tile_supports(ctx: Context) -> str | None:
    rank, repeats = ctx.graph.rank(ctx.node.input[0]), ctx.value(ctx.node.input[1])
    if rank is None:
        return "unknown rank of the input"
    return None if repeats is not None or ctx.shape(ctx.node.input[1]) == [rank] else "unknown number of repeats"


@adjoint("Tile", supports=_tile_supports)
def tile(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x laid out r_i times along axis i;  dx = the sum of dy over the copies.

    dy: (r_0 d_0, r_1 d_1, ...) -> (r_0, d_0, r_1, d_1, ...), summed over every r_i, one at a time.
    """
    x, repeats = node.input
    known = ctx.value(repeats)
    shape: list[Ints] = []
    copies: list[int] = []
    for axis in range(ctx.rank(x)):
        if known is None or known[axis] != 1:
            copies.append(len(shape))
            times: Ints = [] if known is None else [int(known[axis])]
            shape.append(times or slice_axes(ctx, repeats, [axis], [axis + 1], [0], f"copies_{axis}"))
        shape.append(size_of(ctx, x, axis, f"size_{axis}"))
    dx = ctx.op("Reshape", grad_y, concat_ints(ctx, shape, "apart_shape"), role="apart")
    for axis in reversed(copies):
        dx = reduce(ctx, "ReduceSum", dx, [axis], f"sum_{axis}", keepdims=0)
    return [dx]


@adjoint("Transpose", supports=rank_is_known)
def transpose(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x with axis perm[i] as axis i;  dx = dy turned by the inverse permutation."""
    perm = ctx.attrs.get("perm") or list(range(ctx.rank(node.input[0])))[::-1]
    return [ctx.op("Transpose", grad_y, role="dx", perm=[int(i) for i in np.argsort(perm)])]


@adjoint("DepthToSpace")
def depth_to_space(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """x: (N, b b C, H, W) -> y: (N, C, b H, b W), a permutation;  dx = SpaceToDepth(dy).

    SpaceToDepth gives the channels in the order (b b, C), as DCR takes them; CRD has them as (C, b b).
    """
    x, block = node.input[0], ctx.attrs["blocksize"]
    dx = ctx.op("SpaceToDepth", grad_y, role="dx", blocksize=block)
    if ctx.attrs.get("mode", "DCR") == "DCR":
        return [dx]
    channels = size_of(ctx, node.output[0], 1, "channels")
    grouped = concat_ints(ctx, [[0, block * block], channels, [-1]], "grouped_shape")
    apart = ctx.op("Reshape", dx, grouped, role="grouped")
    turned = ctx.op("Transpose", apart, role="turned", perm=[0, 2, 1, 3])
    return [ctx.op("Reshape", turned, shape_of(ctx, x, "x_shape"), role="dx_crd")]


@adjoint("SpaceToDepth")
def space_to_depth(ctx: Context, _node: onnx.NodeProto, grad_y: str) -> Gradients:
    """x: (N, C, b H, b W) -> y: (N, b b C, H, W), a permutation;  dx = DepthToSpace(dy)."""
    return [ctx.op("DepthToSpace", grad_y, role="dx", blocksize=ctx.attrs["blocksize"], mode="DCR")]
