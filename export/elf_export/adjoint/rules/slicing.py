"""Adjoints of ops that cut, join or pick pieces of a tensor."""

from __future__ import annotations

import numpy as np
import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect.emit import (
    FAR,
    Ints,
    arithmetic,
    concat_ints,
    flip,
    ints,
    one_hot,
    place,
    scalar,
    shape_of,
    size_of,
    slice_axes,
    unsqueeze,
    zeros_like,
)  # fmt: skip

from .shapes import rank_is_known


@adjoint("Concat", inputs=None, supports=rank_is_known)
def concat(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = [x_1, x_2, ...] along an axis;  dx_i = the i-th piece of dy."""
    axis = ctx.attrs["axis"] % ctx.rank(node.input[0])
    grads: list[str | None] = []
    start: Ints = [0]
    for i, (name, wanted) in enumerate(zip(node.input, ctx.wanted, strict=True)):
        end = arithmetic(ctx, "Add", start, size_of(ctx, name, axis, f"size_{i}"), f"end_{i}")
        grads.append(slice_axes(ctx, grad_y, start, end, [axis], f"piece_{i}") if wanted else None)
        start = end
    return grads


@adjoint("Split", outputs=None, supports=rank_is_known)
def split(ctx: Context, node: onnx.NodeProto, *grads: str | None) -> Gradients:
    """[y_1, y_2, ...] = x along an axis;  dx = [dy_1, dy_2, ...], zeros for a y_i that nobody used."""
    pieces = [
        grad or zeros_like(ctx, name, f"nothing_{i}")
        for i, (name, grad) in enumerate(zip(node.output, grads, strict=True))
    ]
    return [ctx.op("Concat", *pieces, role="dx", axis=ctx.attrs.get("axis", 0))]


def _slice_supports(ctx: Context) -> str | None:
    axes, steps = ctx.input(3), ctx.input(4)
    if axes and ctx.value(axes) is None:
        return "axes that are computed"
    if steps and ctx.value(steps) is None:
        return "steps that are computed"
    if not axes and (ctx.shape(ctx.input(1)) or [None])[0] is None:
        return "an unknown number of axes"
    return rank_is_known(ctx)


@adjoint("Slice", supports=_slice_supports)
def slice_(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y_k = x_{b + k s} along each axis;  dx_{b + k s} = dy_k, zero elsewhere.   s: the step

    Clamped and negative bounds are resolved by slicing the places 0, 1, 2 ... of the axis in the same way;
    the first that is left is b.  A backward slice is turned round, s - 1 zeros are put between the pixels.
    """
    x, starts, ends = node.input[:3]
    axes_value, steps_value = ctx.value(ctx.input(3)), ctx.value(ctx.input(4))
    bounds = ctx.shape(starts) or []
    if axes_value is None:
        assert isinstance(bounds[0], int)
        axes_value = np.arange(bounds[0])
    axes = [int(a) % ctx.rank(x) for a in axes_value]
    steps = [1] * len(axes) if steps_value is None else [int(s) for s in steps_value]
    dx = grad_y
    for i, (axis, step) in enumerate(zip(axes, steps, strict=True)):
        tag = f"axis_{axis}"
        size = size_of(ctx, x, axis, f"{tag}_size")
        zero, one = ctx.const(0, f"{tag}_zero"), ctx.const(1, f"{tag}_one")
        places = ctx.op("Range", zero, scalar(ctx, size, f"{tag}_depth"), one, role=f"{tag}_places")
        bound = [
            slice_axes(ctx, v, [i], [i + 1], [0], f"{tag}_{what}") for v, what in ((starts, "start"), (ends, "end"))
        ]
        bound = [ctx.op("Cast", b, role=f"{tag}_bound", to=onnx.TensorProto.INT64) for b in bound]
        kept = ctx.op(
            "Slice",
            places,
            *bound,
            ctx.int64s([0], f"{tag}_0"),
            ctx.int64s([step], f"{tag}_step"),
            role=f"{tag}_kept",
        )
        if step < 0:
            dx = flip(ctx, dx, [axis], f"{tag}_forwards")
        begin = slice_axes(ctx, kept, *(([0], [1]) if step > 0 else ([-1], [FAR])), [0], f"{tag}_begin")
        length: Ints = ctx.op("Shape", kept, role=f"{tag}_length")
        if abs(step) > 1:
            dx, length = _spread(ctx, dx, x, axis, abs(step), arithmetic(ctx, "Sub", size, begin, f"{tag}_room"), tag)
        dx = place(ctx, dx, x, axis, begin, length, f"{tag}_placed")
    return [dx]


def _spread(ctx: Context, dy: str, x: str, axis: int, step: int, room: Ints, tag: str) -> tuple[str, Ints]:
    """`step` - 1 zeros behind each entry along `axis`, cut to `room`; and the length of that."""
    rank = ctx.rank(x)
    column = unsqueeze(ctx, dy, [axis + 1], f"{tag}_column")
    pads = [0] * 2 * (rank + 1)
    pads[rank + 1 + axis + 1] = step - 1
    padded = ctx.op(
        "Pad", column, ctx.int64s(pads, f"{tag}_gaps"), ctx.const(0, f"{tag}_fill", like=x), mode="constant"
    )
    shape = ctx.op("Shape", dy, role=f"{tag}_shape")
    merge = concat_ints(ctx, [[1] * axis, [step], [1] * (rank - axis - 1)], f"{tag}_merge")
    joined = ctx.op("Reshape", padded, ctx.op("Mul", shape, merge, role=f"{tag}_joined_shape"), role=f"{tag}_joined")
    cut = slice_axes(ctx, joined, [0], room, [axis], f"{tag}_cut")
    return cut, slice_axes(
        ctx, ctx.op("Shape", cut, role=f"{tag}_cut_shape"), [axis], [axis + 1], [0], f"{tag}_cut_size"
    )


@adjoint("Gather", supports=lambda ctx: rank_is_known(ctx) or (
    "unknown rank of the indices" if ctx.graph.rank(ctx.node.input[1]) is None else None
))  # fmt: skip
def gather(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x[:, i_k, :] along an axis;  dx = sum over k of dy_k put at place i_k = dy P.   P: (K, D), one-hot

    (pre, K..., post) -> (pre, post, K) P -> (pre, post, D) -> (pre, D, post)
    """
    x, indices = node.input
    rank = ctx.rank(x)
    axis = ctx.attrs.get("axis", 0) % rank
    index_rank = ctx.rank(indices)
    size = size_of(ctx, x, axis, "size")
    if index_rank == 0:
        dy = unsqueeze(ctx, grad_y, [axis], "with_axis")
        flat = unsqueeze(ctx, indices, [0], "index")
    elif index_rank == 1:
        dy, flat = grad_y, indices
    else:
        # Join the axes of the indices: K of them become one.
        before, after = _shape_part(ctx, x, 0, axis, "before"), _shape_part(ctx, x, axis + 1, rank, "after")
        dy = ctx.op("Reshape", grad_y, concat_ints(ctx, [before, [-1], after], "joined_shape"), role="joined")
        flat = ctx.op("Reshape", indices, ctx.int64s([-1], "flat_shape"), role="flat")
    flat = ctx.op("Cast", flat, role="index_int64", to=onnx.TensorProto.INT64)
    below = ctx.op("Less", flat, ctx.int64s([0], "zero"), role="negative")
    wrapped = ctx.op("Where", below, ctx.op("Add", flat, ints(ctx, size, "depth")), flat, role="wrapped")
    return [along_axis(ctx, dy, one_hot(ctx, wrapped, size, x, "picked"), axis, rank, "dx")]


def along_axis(ctx: Context, dy: str, matrix: str, axis: int, rank: int, role: str) -> str:
    """dy times a (K, D) matrix along one axis: (..., K, ...) -> (..., D, ...)."""
    if axis == rank - 1:
        return ctx.op("MatMul", dy, matrix, role=role)
    if axis == rank - 2:
        turned = ctx.op("Transpose", matrix, role=f"{role}_matrix", perm=[1, 0])
        return ctx.op("MatMul", turned, dy, role=role)
    perm = [*range(axis), *range(axis + 1, rank), axis]
    back = [*range(axis), rank - 1, *range(axis, rank - 1)]
    product = ctx.op("MatMul", ctx.op("Transpose", dy, role=f"{role}_last", perm=perm), matrix, role=f"{role}_product")
    return ctx.op("Transpose", product, role=role, perm=back)


def _shape_part(ctx: Context, x: str, start: int, end: int, role: str) -> Ints:
    dims = (ctx.shape(x) or [])[start:end]
    if all(isinstance(d, int) for d in dims):
        return [d for d in dims if isinstance(d, int)]
    return slice_axes(ctx, shape_of(ctx, x, f"{role}_of"), [start], [end], [0], role)
