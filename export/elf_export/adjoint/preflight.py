"""What can't be differentiated, and why: asked before anything is written, so that all of it is reported at once."""

from __future__ import annotations

import onnx

from elf_export.errors import UnsupportedGraphError, UnsupportedNode
from elf_export.graph.graph import Graph, is_standard

from . import broadcast
from .path import reach, trace
from .registry import Context, NeedsOpset, entry_for, is_floating, supported_ops
from .same_size import Sizes

# Integer arithmetic whose scales are computed with the image.
QUANTISED = frozenset({
    "DynamicQuantizeLinear", "ConvInteger", "MatMulInteger", "QLinearConv", "QLinearMatMul", "QLinearAdd", "QLinearMul",
    "DynamicQuantizeMatMul", "MatMulIntegerToFloat", "MatMulNBits", "QGemm", "QLinearConcat", "QLinearAveragePool",
    "QLinearGlobalAveragePool", "QLinearSigmoid", "QLinearLeakyRelu", "QLinearSoftmax", "QLinearReduceMean",
})  # fmt: skip


def unsupported_behind(graph: Graph, source: str) -> dict[str, str]:
    """First output of every node that can't be differentiated w.r.t. `source` -> why; for listings."""
    able, reached = reach(graph, source)
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
    path, live = trace(graph, source, target)
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
