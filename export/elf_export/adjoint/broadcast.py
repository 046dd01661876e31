"""The adjoint of broadcasting: what was repeated is summed up."""

from __future__ import annotations

from dataclasses import dataclass

import onnx

from elf_export.dialect.emit import reduce, squeeze
from elf_export.graph.graph import Graph

from .registry import Context, NeedsOpset
from .same_size import Sizes

AT_RUN_TIME = 13  # the opset from which on ReduceSum takes axes that are computed


@dataclass(frozen=True)
class Repeats:
    """Along which axes a node's result repeats one of its inputs.

    Attributes
    ----------
    lead : int
        Axes in front that the input does not have.
    axes : axes of the result where the input's size is 1
    unsure : axes of the result where only the run can tell
    """

    lead: int
    axes: tuple[int, ...]
    unsure: tuple[int, ...]


def repeats(graph: Graph, sizes: Sizes, name: str, result: str, core_axes: int = 0) -> Repeats | None:
    """How `result` repeats `name`; None if the rank of either is unknown."""
    shape, out = graph.shape(name), graph.shape(result)
    if shape is None or out is None:
        return None
    lead = len(out) - len(shape)
    axes, unsure = [], []
    for i, dim in enumerate(shape[: len(shape) - core_axes]):
        if dim == 1:
            if out[lead + i] != 1:
                axes.append(lead + i)
        elif not isinstance(dim, int) and sizes.of(name, i) != sizes.of(result, lead + i):
            unsure.append(lead + i)
    return Repeats(lead, tuple(axes), tuple(unsure))


def why_not(graph: Graph, sizes: Sizes, node: onnx.NodeProto, wanted: list[bool], core_axes: int) -> str | None:
    """Why the broadcasting of `node` can't be undone, None if it can."""
    for name, want in zip(node.input, wanted, strict=True):
        if not want:
            continue
        found = repeats(graph, sizes, name, node.output[0], core_axes)
        if found is None:
            return f"unknown rank of {name!r}"
        if found.unsure and graph.opset < AT_RUN_TIME:
            return NeedsOpset(
                f"whether {name!r} is repeated along axes {list(found.unsure)} is known at run time only; "
                f"fix the input's size, or use opset {AT_RUN_TIME} or later",
                AT_RUN_TIME,
            )
    return None


def unbroadcast(ctx: Context, sizes: Sizes, grad: str, name: str, core_axes: int = 0) -> str:
    """Sum `grad`, of the shape of the node's result, to the shape of its input `name`."""
    found = repeats(ctx.graph, sizes, name, ctx.node.output[0], core_axes)
    assert found is not None, f"unknown rank of {name!r}"
    axes = [*range(found.lead), *found.axes]
    for axis in reversed(axes):  # one at a time: see emit.mean
        grad = reduce(ctx, "ReduceSum", grad, [axis], f"unbroadcast_{axis}")
    if found.lead:
        grad = squeeze(ctx, grad, list(range(found.lead)), "squeeze")
    if found.unsure:
        same = ctx.op("Equal", ctx.op("Shape", name, role="own_shape"), ctx.op("Shape", grad, role="grad_shape"))
        differ = ctx.op("NonZero", ctx.op("Not", same), role="repeated")  # (1, axes)
        at_run_time = squeeze(ctx, differ, [0], "repeated_axes")
        grad = reduce(ctx, "ReduceSum", grad, at_run_time, "unbroadcast_at_run_time", noop=1)
    return grad
