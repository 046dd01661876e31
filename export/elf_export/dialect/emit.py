"""Emitting ops whose form depends on the opset, and index arithmetic that works on static and run-time sizes.

An int64 vector is a sequence of ints where it is known now, the name of a value where the run tells it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .emitter import Emitter

FAR = 2**31 - 1  # "to the end" for Slice

Ints = str | Sequence[int]


def step(ctx: Emitter, v: str, role: str) -> str:
    """[v > 0] as numbers."""
    return ctx.own("Step", v, role=role)


def between(ctx: Emitter, low: str, high: str, y: str, role: str) -> str:
    """[low < y < high] as numbers; a bound that is empty bounds nothing."""
    return ctx.own("Between", low, high, y, role=role)


def ints(ctx: Emitter, values: Ints, role: str) -> str:
    """`values` as the name of an int64 vector."""
    return values if isinstance(values, str) else ctx.int64s(values, role)


def concat_ints(ctx: Emitter, parts: Sequence[Ints], role: str) -> str:
    """int64 vectors one behind the other."""
    if not any(isinstance(part, str) for part in parts):
        return ctx.int64s([i for part in parts for i in part if isinstance(i, int)], role)
    names = [ints(ctx, part, f"{role}_{i}") for i, part in enumerate(parts) if len(part)]
    return names[0] if len(names) == 1 else ctx.op("Concat", *names, role=role, axis=0)


def reduce(
    ctx: Emitter, op: str, x: str, axes: Ints | None, role: str, keepdims: int = 1, noop: int | None = None
) -> str:
    """A Reduce* op; axes are an input from opset 18 on, of ReduceSum from 13.  None reduces all axes."""
    as_input = ctx.opset >= (13 if op == "ReduceSum" else 18)
    if axes is None:
        return ctx.op(op, x, role=role, keepdims=keepdims)
    if as_input:
        name = ints(ctx, axes, f"{role}_axes")
        return ctx.op(op, x, name, role=role, keepdims=keepdims, noop_with_empty_axes=noop)
    assert not isinstance(axes, str), f"run-time axes of {op} need a later opset than {ctx.opset}"
    return ctx.op(op, x, role=role, axes=list(axes), keepdims=keepdims)


def mean(ctx: Emitter, x: str, axes: Sequence[int], role: str) -> str:
    """ReduceMean, one axis at a time: a float32 sum over a whole image at once is off by 1e-5 of itself."""
    for axis in sorted(axes, reverse=True):
        x = reduce(ctx, "ReduceMean", x, [axis], f"{role}_{axis}")
    return x


def squeeze(ctx: Emitter, x: str, axes: Sequence[int], role: str, outputs: int | Sequence[str] = 1) -> str:
    if ctx.opset >= 13:
        return ctx.op("Squeeze", x, ctx.int64s(axes, f"{role}_axes"), role=role, outputs=outputs)
    return ctx.op("Squeeze", x, role=role, outputs=outputs, axes=list(axes))


def unsqueeze(ctx: Emitter, x: str, axes: Ints, role: str) -> str:
    if ctx.opset >= 13:
        return ctx.op("Unsqueeze", x, ints(ctx, axes, f"{role}_axes"), role=role)
    assert not isinstance(axes, str), "run-time axes need opset 13"
    return ctx.op("Unsqueeze", x, role=role, axes=list(axes))


def slice_axes(ctx: Emitter, x: str, starts: Ints, ends: Ints, axes: Ints, role: str, steps: Ints | None = None) -> str:
    bounds = [ints(ctx, v, f"{role}_{what}") for v, what in ((starts, "starts"), (ends, "ends"), (axes, "axes"))]
    if steps is not None:
        bounds.append(ints(ctx, steps, f"{role}_steps"))
    return ctx.op("Slice", x, *bounds, role=role)


def flip(ctx: Emitter, x: str, axes: Sequence[int], role: str) -> str:
    """x read backwards along `axes`."""
    n = len(axes)
    return slice_axes(ctx, x, [-1] * n, [-FAR] * n, axes, role, steps=[-1] * n)


def shape_of(ctx: Emitter, x: str, role: str) -> str:
    """int64 (rank,): the shape of the forward value `x`, a constant where it is static."""
    dims = ctx.shape(x)
    if dims is not None and all(isinstance(d, int) for d in dims):
        return ctx.int64s([d for d in dims if isinstance(d, int)], role)
    return ctx.op("Shape", x, role=role)


def size_of(ctx: Emitter, x: str, axis: int, role: str) -> Ints:
    """int64 (1,): the size of the forward value `x` along one axis >= 0."""
    dims = ctx.shape(x)
    size = dims[axis] if dims is not None else None
    if isinstance(size, int):
        return [size]
    return slice_axes(ctx, ctx.op("Shape", x, role=f"{role}_shape"), [axis], [axis + 1], [0], role)


def scalar(ctx: Emitter, vector: Ints, role: str) -> str:
    """int64 (1,) -> int64 ()."""
    if isinstance(vector, str):
        return squeeze(ctx, vector, [0], role)
    return ctx.const(np.array(vector[0], np.int64), role)


def arithmetic(ctx: Emitter, op: str, a: Ints, b: Ints, role: str) -> Ints:
    """Add, Sub or Mul of int64 (1,) vectors, done now where both are known."""
    if isinstance(a, str) or isinstance(b, str):
        return ctx.op(op, ints(ctx, a, f"{role}_a"), ints(ctx, b, f"{role}_b"), role=role)
    x, y = a[0], b[0]
    return [{"Add": x + y, "Sub": x - y, "Mul": x * y}[op]]


def pad_axis(ctx: Emitter, x: str, like: str, axis: int, begin: Ints, end: Ints, role: str) -> str:
    """Put `begin` and `end` zeros (int64 (1,), >= 0) around `x` along one axis; `x` has `like`'s rank."""
    if begin == [0] and end == [0]:
        return x
    rank = ctx.rank(like)
    zeros = [0] * (rank - 1)
    pads = concat_ints(ctx, [zeros[:axis], begin, zeros, end, zeros[axis:]], f"{role}_pads")
    return ctx.op("Pad", x, pads, ctx.const(0, f"{role}_fill", like=like), role=role, mode="constant")


def place(ctx: Emitter, piece: str, like: str, axis: int, begin: Ints, length: Ints, role: str) -> str:
    """Zeros of `like`'s size along `axis`, with `piece`, `length` long, from `begin` on."""
    used = arithmetic(ctx, "Add", begin, length, f"{role}_stop")
    rest = arithmetic(ctx, "Sub", size_of(ctx, like, axis, f"{role}_size"), used, f"{role}_rest")
    return pad_axis(ctx, piece, like, axis, begin, rest, role)


def positive_part(ctx: Emitter, x: str, role: str) -> str:
    """max(x, 0) of integers; Max takes them from opset 12 on only."""
    zero = ctx.int64s([0], f"{role}_zero")
    return ctx.op("Where", ctx.op("Greater", x, zero, role=f"{role}_above"), x, zero, role=role)


def zeros_like(ctx: Emitter, x: str, role: str) -> str:
    """Zeros of the shape and dtype of the forward value `x`."""
    return ctx.op("Expand", ctx.const(0, f"{role}_zero", like=x), shape_of(ctx, x, f"{role}_shape"), role=role)


def as_number(ctx: Emitter, condition: str, like: str, role: str) -> str:
    """A boolean tensor as 0 and 1 of `like`'s dtype."""
    return ctx.op("Cast", condition, role=role, to=ctx.graph.elem_type(like))


def one_hot(ctx: Emitter, indices: str, depth: Ints, like: str, role: str) -> str:
    """(K,) int64 indices in [0, D) -> (K, D) rows of 0 and one 1, of `like`'s dtype."""
    zero, one = (ctx.const(np.array(i, np.int64), f"{role}_{i}") for i in (0, 1))
    places = ctx.op("Range", zero, scalar(ctx, depth, f"{role}_depth"), one, role=f"{role}_places")
    hit = ctx.op("Equal", unsqueeze(ctx, indices, [1], f"{role}_column"), places, role=f"{role}_hit")
    return as_number(ctx, hit, like, role)
