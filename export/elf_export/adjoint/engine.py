"""Reverse-mode differentiation over ONNX nodes.

For y = f(x) the adjoint of a node takes dL/dy to dL/dx.  Walking the nodes between the image and the layer
backwards, each node's output gradients are complete once all its readers have been visited.  This module
owns everything that is the same for all ops: which nodes lie on a path, accumulation of several uses,
un-broadcasting, and the seed.  What is particular to an op is in its rule.
"""

from __future__ import annotations

import onnx

from elf_export.errors import LayerError, UnsupportedGraphError, UnsupportedNode
from elf_export.graph.graph import Graph, captured, is_standard

from . import broadcast, phases
from .gradient import ADJOINT, Part
from .interleave import whole
from .registry import (
    Context,
    NeedsOpset,
    entry_for,
    has_no_gradient,
    is_floating,
    is_straight_through,
    supported_ops,
)
from .same_size import Sizes

# Integer arithmetic whose scales are computed with the image.
QUANTISED = frozenset({
    "DynamicQuantizeLinear", "ConvInteger", "MatMulInteger", "QLinearConv", "QLinearMatMul", "QLinearAdd", "QLinearMul",
    "DynamicQuantizeMatMul", "MatMulIntegerToFloat", "MatMulNBits", "QGemm", "QLinearConcat", "QLinearAveragePool",
    "QLinearGlobalAveragePool", "QLinearSigmoid", "QLinearLeakyRelu", "QLinearSoftmax", "QLinearReduceMean",
})  # fmt: skip


def build_adjoint(graph: Graph, output: str, wrt: str, seed: str | None = None, channels_last: bool = False) -> str:
    """As `adjoint_parts`, the gradient in one piece: a value of the shape of `wrt`."""
    return whole(graph, adjoint_parts(graph, output, wrt, seed, channels_last))


def adjoint_parts(graph: Graph, output: str, wrt: str, seed: str | None = None, channels_last: bool = False) -> Part:
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
    channels_last : bool
        The form of max-pooling's adjoint: for convolutions that run channels last, as 8-bit ones do (see
        `interleaved`), or in blocks of channels, as ONNX Runtime's float ones (see `phases`).

    Returns
    -------
    str or Phases
        Name of the gradient, of the shape of `wrt`, or its phases where it arrives in such.

    Raises
    ------
    LayerError
        If `output` does not depend on `wrt`, or only through ops that pass no gradient.
    UnsupportedGraphError
        Listing every node on the way that has no rule; nothing has been appended then.
    """
    path, live = _trace(graph, wrt, output)
    if not path and output != wrt:
        raise LayerError(f"{output!r} does not depend on {wrt!r}, or only through ops that pass no gradient")
    sizes = Sizes(graph)
    preflight(graph, path, live, sizes)

    pending: dict[str, list[Part]] = {output: [seed if seed is not None else output]}
    for node in reversed(path):
        entry = entry_for(node)
        assert entry is not None, "preflight has seen to that"
        grads = [_total(graph, name, pending.get(name)) for name in node.output[: entry.outputs]]
        if not any(grads):
            continue
        wanted = [name in live for name in node.input]
        context = Context(graph, node, wanted, channels_last)
        given = phases.apply(entry.rule, context, grads)
        given += [None] * (len(node.input) - len(given))
        for name, want, grad in zip(node.input, wanted, given, strict=True):
            if want:
                assert grad is not None, f"rule {node.op_type} gives no gradient of {name!r}"
                if entry.broadcasts:
                    assert isinstance(grad, str), "only MaxPool, Relu and Conv give phases"
                    grad = broadcast.unbroadcast(context, sizes, grad, name, entry.core_axes)
                pending.setdefault(name, []).append(grad)
    total = _total(graph, wrt, pending.get(wrt))
    assert total is not None, f"the gradient of {output!r} never reaches {wrt!r}"
    return total


def nodes_between(graph: Graph, source: str, target: str) -> list[onnx.NodeProto]:
    """The nodes on any differentiable path from `source` to `target`, in graph order."""
    return _trace(graph, source, target)[0]


def _trace(graph: Graph, source: str, target: str) -> tuple[list[onnx.NodeProto], set[str]]:
    """The nodes on the differentiable paths, and the values on them."""
    able, reached = _reach(graph, source)
    live, path = {target} & reached, []
    for node in reversed(able):
        if live.intersection(node.output) and source not in node.output:
            path.append(node)
            live.update(reached.intersection((*node.input, *captured(node))))
    return path[::-1], live


def _reach(graph: Graph, source: str) -> tuple[list[onnx.NodeProto], set[str]]:
    """The nodes that may pass a gradient, and the values that one from `source` may reach."""
    able = [node for node in graph.nodes if not has_no_gradient(node)]
    reached = {source}
    for node in able:
        arriving = reached.intersection((*node.input, *captured(node)))
        if arriving:
            # Whatever reads quantised integers is kept on the path, for preflight to judge.
            whole = is_straight_through(node) or not all(is_floating(graph, name) for name in arriving)
            reached.update(name for name in node.output if name and (whole or is_floating(graph, name)))
    return able, reached


def unsupported_behind(graph: Graph, source: str) -> dict[str, str]:
    """First output of every node that can't be differentiated w.r.t. `source` -> why; for listings."""
    able, reached = _reach(graph, source)
    sizes = Sizes(graph)
    found = {}
    for node in able:
        context = Context(graph, node, [name in reached for name in node.input])
        if reached.intersection(node.output):
            reason = why_unsupported(context, reached.intersection(node.output[:1]), sizes)
            if reason:
                found[str(node.output[0])] = reason
    return found


def opset_wanted(graph: Graph, source: str, target: str) -> int:
    """The opset whose rules the nodes between `source` and `target` need; 0 where their own will do."""
    path, live = _trace(graph, source, target)
    sizes = Sizes(graph)
    reasons = [
        why_unsupported(Context(graph, node, [name in live for name in node.input]), live, sizes) for node in path
    ]
    return max((reason.opset for reason in reasons if isinstance(reason, NeedsOpset)), default=0)


def preflight(graph: Graph, path: list[onnx.NodeProto], live: set[str], sizes: Sizes) -> None:
    """Raise UnsupportedGraphError with all the nodes of `path` that have no adjoint."""
    bad = []
    for node in path:
        context = Context(graph, node, [name in live for name in node.input])
        reason = why_unsupported(context, live, sizes)
        if reason:
            bad.append(UnsupportedNode(node.name or node.output[0], node.op_type, graph.opset, reason))
    if bad:
        raise UnsupportedGraphError(bad, supported_ops())


def why_unsupported(ctx: Context, live: set[str], sizes: Sizes) -> str | None:
    """Why the context's node can't be differentiated, None if it can.  `live`: the values on the path."""
    node, entry = ctx.node, entry_for(ctx.node)
    if entry is None and node.op_type in QUANTISED:
        return "the network is quantised in a way that can't be taken out again; export the float one it was made from"
    if not is_standard(node):
        return f"domain {node.domain!r} is not standard ONNX"
    if entry is None:
        return "no rule"
    if ctx.opset < entry.since_opset:
        return NeedsOpset(f"the rule needs opset {entry.since_opset} or later", entry.since_opset)
    for i, name in enumerate(node.input):
        if ctx.wanted[i] and not (entry.through_integers or is_floating(ctx.graph, name)):
            return f"its input {name!r} holds integers, which pass a gradient to DequantizeLinear only"
        if entry.inputs is not None and i >= entry.inputs and ctx.wanted[i]:
            return f"its input {name!r} depends on the image; the rule takes what does not there"
    for i, name in enumerate(node.output):
        if entry.outputs is not None and i >= entry.outputs and name in live:
            return f"its output {name!r} is used; the rule knows the gradient of the first {entry.outputs} only"
    reason = entry.supports(ctx) if entry.supports else None
    if reason is None and entry.broadcasts:
        reason = broadcast.why_not(ctx.graph, sizes, node, list(ctx.wanted), entry.core_axes)
    return reason


def _total(graph: Graph, name: str, parts: list[Part] | None) -> Part | None:
    """The sum of what the readers of `name` sent back."""
    if not parts:
        return None
    if len(parts) > 1:
        parts[:] = [graph.op("Sum", *(whole(graph, p) for p in parts), name=f"{ADJOINT}{name}/accumulate")]
    return parts[0]
