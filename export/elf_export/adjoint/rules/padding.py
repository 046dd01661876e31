"""Adjoint of Pad."""

from __future__ import annotations

from collections.abc import Callable

import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect.emit import FAR, Ints, arithmetic, flip, place, reduce, shape_of, size_of, slice_axes

from .shapes import rank_is_known


def _pad_supports(ctx: Context) -> str | None:
    mode, pads = ctx.attrs.get("mode", "constant"), ctx.value(ctx.input(1))
    if ctx.input(3) and (ctx.value(ctx.input(3)) is None or pads is None):
        return "axes, or pads of some axes, that are computed"
    if mode != "constant" and pads is None:
        return f"mode {mode!r} with pads that are computed"
    if mode not in ("constant", "reflect", "edge", "wrap"):
        return f"mode {mode!r}"
    if pads is not None and pads.min(initial=0) < 0:
        return "pads below zero"
    return rank_is_known(ctx)


@adjoint("Pad", supports=_pad_supports)
def pad(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """y = x with p places in front and q behind along each axis;  dx = the middle of dy (D of p + D + q),

    and where the border repeats x, the border's gradient comes back to the places that it repeats:
    reflect: mirrored, next to x's first and last; edge: summed up, on them; wrap: at the other end.
    """
    x, rank = node.input[0], ctx.rank(node.input[0])
    pads = ctx.value(node.input[1])
    if pads is None:
        shape = shape_of(ctx, x, "x_shape")
        begin = slice_axes(ctx, node.input[1], [0], [rank], [0], "begin")
        return [slice_axes(ctx, grad_y, begin, ctx.op("Add", begin, shape, role="end"), list(range(rank)), "dx")]
    axes = [int(a) % rank for a in ctx.value(ctx.input(3))] if ctx.input(3) else list(range(rank))  # type: ignore[union-attr]
    before, after = ([int(p) for p in half] for half in (pads[: len(axes)], pads[len(axes) :]))
    borders = {"reflect": _reflect, "edge": _edge, "wrap": _wrap}.get(ctx.attrs.get("mode", "constant"))
    for axis, p, q in zip(axes, before, after, strict=True):
        if p or q:
            grad_y = _unpad(ctx, grad_y, x, axis, p, q, borders)
    return [grad_y]


Borders = Callable[[Context, str, str, int, int, int, Ints], list[str]]


def _unpad(ctx: Context, dy: str, x: str, axis: int, p: int, q: int, borders: Borders | None) -> str:
    """The adjoint along one axis: (..., p + D + q, ...) -> (..., D, ...)."""
    tag = f"axis_{axis}"
    size = size_of(ctx, x, axis, f"{tag}_size")
    end = arithmetic(ctx, "Add", [p], size, f"{tag}_end")
    middle = slice_axes(ctx, dy, [p], end, [axis], f"{tag}_middle")
    if borders is None:
        return middle
    return ctx.op("Sum", middle, *borders(ctx, dy, x, axis, p, q, size), role=f"{tag}_sum")


def _ends(ctx: Context, dy: str, axis: int, p: int, q: int) -> tuple[str | None, str | None]:
    """The first p and the last q of `dy` along an axis, None for 0."""
    first = slice_axes(ctx, dy, [0], [p], [axis], f"axis_{axis}_front") if p else None
    last = slice_axes(ctx, dy, [-q], [FAR], [axis], f"axis_{axis}_back") if q else None
    return first, last


def _reflect(ctx: Context, dy: str, x: str, axis: int, p: int, q: int, size: Ints) -> list[str]:
    first, last = _ends(ctx, dy, axis, p, q)
    parts, tag = [], f"axis_{axis}"
    if first:
        mirrored = flip(ctx, first, [axis], f"{tag}_front_mirrored")
        parts.append(place(ctx, mirrored, x, axis, [1], [p], f"{tag}_front_placed"))
    if last:
        mirrored = flip(ctx, last, [axis], f"{tag}_back_mirrored")
        start = arithmetic(ctx, "Sub", size, [q + 1], f"{tag}_back_start")
        parts.append(place(ctx, mirrored, x, axis, start, [q], f"{tag}_back_placed"))
    return parts


def _edge(ctx: Context, dy: str, x: str, axis: int, p: int, q: int, size: Ints) -> list[str]:
    first, last = _ends(ctx, dy, axis, p, q)
    parts, tag = [], f"axis_{axis}"
    if first:
        total = reduce(ctx, "ReduceSum", first, [axis], f"{tag}_front_sum")
        parts.append(place(ctx, total, x, axis, [0], [1], f"{tag}_front_placed"))
    if last:
        total = reduce(ctx, "ReduceSum", last, [axis], f"{tag}_back_sum")
        start = arithmetic(ctx, "Sub", size, [1], f"{tag}_back_start")
        parts.append(place(ctx, total, x, axis, start, [1], f"{tag}_back_placed"))
    return parts


def _wrap(ctx: Context, dy: str, x: str, axis: int, p: int, q: int, size: Ints) -> list[str]:
    first, last = _ends(ctx, dy, axis, p, q)
    parts, tag = [], f"axis_{axis}"
    if first:
        start = arithmetic(ctx, "Sub", size, [p], f"{tag}_front_start")
        parts.append(place(ctx, first, x, axis, start, [p], f"{tag}_front_placed"))
    if last:
        parts.append(place(ctx, last, x, axis, [0], [q], f"{tag}_back_placed"))
    return parts
