"""Reverse-mode differentiation over ONNX nodes.

For y = f(x) the adjoint of a node takes dL/dy to dL/dx.  Walking the nodes between the image and the layer
backwards, each node's output gradients are complete once all its readers have been visited.  This module
owns everything that is the same for all ops: which nodes lie on a path, accumulation of several uses,
un-broadcasting, and the seed.  What is particular to an op is in its rule.
"""

from __future__ import annotations

import onnx

from ..errors import LayerError, UnsupportedGraphError, UnsupportedNode
from ..graph import Graph
from .registry import Context, has_no_gradient, rule_for, supported_ops, why_unsupported


def build_adjoint(graph: Graph, output: str, wrt: str, seed: str | None = None) -> str:
    """Append the nodes that compute the vector-Jacobian product seed^T d(output)/d(wrt).

    Parameters
    ----------
    graph : Graph
        Holds the forward nodes; the adjoint's are appended.
    output, wrt : str
        Values of the forward graph.
    seed : str, optional
        A value of the shape of `output`; `output` itself by default, which makes the result the gradient of
        1/2 ||output||^2, ELF's F^T dF/dI.

    Returns
    -------
    str
        Name of the gradient, of the shape of `wrt`.

    Raises
    ------
    LayerError
        If `output` does not depend on `wrt`.
    UnsupportedGraphError
        Listing every node on the way that has no rule; nothing has been appended then.
    """
    path = nodes_between(graph, wrt, output)
    if not path and output != wrt:
        raise LayerError(f"{output!r} does not depend on {wrt!r}")
    on_path = {wrt, *(name for node in path for name in node.output)}
    preflight(graph, path, on_path)

    pending: dict[str, list[str]] = {output: [seed if seed is not None else output]}
    for node in reversed(path):
        grads = [_total(graph, name, pending.get(name)) for name in node.output]
        if not any(grads):
            continue
        wanted = [name in on_path for name in node.input]
        context = Context(graph, node, wanted)
        given = rule_for(node.op_type)(context, node, *grads)
        assert len(given) == len(node.input), f"rule {node.op_type}: {len(given)} of {len(node.input)} gradients"
        for name, want, grad in zip(node.input, wanted, given, strict=True):
            if want and grad is not None:
                pending.setdefault(name, []).append(_unbroadcast(context, grad, like=name, of=node))
    total = _total(graph, wrt, pending.get(wrt))
    if total is None:
        raise LayerError(f"the gradient of {output!r} never reaches {wrt!r}")
    return total


def nodes_between(graph: Graph, source: str, target: str) -> list[onnx.NodeProto]:
    """The nodes on any differentiable path from `source` to `target`, in graph order."""
    producers = graph.producers()
    needed: set[str] = set()
    stack = [target]
    while stack:
        name = stack.pop()
        if name in needed or name == source:
            continue
        needed.add(name)
        if name in producers:
            stack.extend(producers[name].input)
    reached = {source}
    path = []
    for node in graph.nodes:
        if has_no_gradient(node.op_type) or not needed.intersection(node.output):
            continue
        if reached.intersection(n for n in node.input if n):
            reached.update(n for n in node.output if n)
            path.append(node)
    return path


def preflight(graph: Graph, path: list[onnx.NodeProto], on_path: set[str]) -> None:
    """Raise UnsupportedGraphError with all the nodes of `path` that have no adjoint."""
    bad = []
    for node in path:
        reason = why_unsupported(Context(graph, node, [name in on_path for name in node.input]))
        if reason:
            bad.append(UnsupportedNode(node.name or node.output[0], node.op_type, graph.opset, reason))
    if bad:
        raise UnsupportedGraphError(bad, supported_ops())


def _total(graph: Graph, name: str, parts: list[str] | None) -> str | None:
    """The sum of what the readers of `name` sent back."""
    if not parts:
        return None
    if len(parts) > 1:
        parts[:] = [graph.op("Sum", *parts, name=f"adj/{name}/accumulate")]
    return parts[0]


def _unbroadcast(ctx: Context, grad: str, like: str, of: onnx.NodeProto) -> str:
    """Sum `grad` over the axes along which the node repeated its input `like`: the adjoint of broadcasting.

    Only for the ops that broadcast; every other rule returns a gradient of its input's shape.
    """
    if of.op_type not in BROADCASTING or len(of.input) < 2:
        return grad
    shape, out = ctx.shape(like), ctx.shape(of.output[0])
    if shape is None or out is None:
        return grad
    lead = len(out) - len(shape)
    axes = [*range(lead), *(lead + i for i, dim in enumerate(shape) if dim == 1 and out[lead + i] != 1)]
    if not axes:
        return grad
    if ctx.opset >= 13:
        grad = ctx.op("ReduceSum", grad, ctx.int64s(axes, "unbroadcast_axes"), role="unbroadcast", keepdims=1)
    else:
        grad = ctx.op("ReduceSum", grad, role="unbroadcast", axes=axes, keepdims=1)
    if not lead:
        return grad
    if ctx.opset >= 13:
        return ctx.op("Squeeze", grad, ctx.int64s(range(lead), "squeeze_axes"), role="squeeze")
    return ctx.op("Squeeze", grad, role="squeeze", axes=list(range(lead)))


BROADCASTING = frozenset(
    {"Add", "Sub", "Mul", "Div", "Pow", "Sum", "Mean", "Max", "Min", "PRelu", "Where", "Expand", "Mod"}
)
