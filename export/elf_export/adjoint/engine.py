"""Reverse-mode differentiation over ONNX nodes.

For y = f(x) the adjoint of a node takes dL/dy to dL/dx.  Walking the nodes between the image and the layer
backwards, each node's output gradients are complete once all its readers have been visited.  This module
owns everything that is the same for all ops: accumulation of several uses, un-broadcasting, and the seed.  What is
particular to an op is in its rule; how fast it is, is the lowering's concern.
"""

from __future__ import annotations

from elf_export.errors import LayerError
from elf_export.graph.graph import Graph

from . import broadcast
from .path import trace
from .preflight import preflight
from .registry import ADJOINT, Context, entry_for
from .same_size import Sizes


def build_adjoint(graph: Graph, output: str, wrt: str, seed: str | None = None) -> str:
    """Append the nodes that compute the vector-Jacobian product seed^T d(output)/d(wrt).

    Parameters
    ----------
    graph : Graph
        Holds the forward nodes; the adjoint's are appended, in standard operations and those of `dialect`, which
        `lowering.lower` makes standard ones of.
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
        If `output` does not depend on `wrt`, or only through ops that pass no gradient.
    UnsupportedGraphError
        Listing every node on the way that has no rule; nothing has been appended then.
    """
    path, live = trace(graph, wrt, output)
    if not path and output != wrt:
        raise LayerError(f"{output!r} does not depend on {wrt!r}, or only through ops that pass no gradient")
    sizes = Sizes(graph)
    preflight(graph, path, live, sizes)

    pending: dict[str, list[str]] = {output: [seed if seed is not None else output]}
    for node in reversed(path):
        entry = entry_for(node)
        assert entry is not None, "checked by preflight"
        grads = [_total(graph, name, pending.get(name)) for name in node.output[: entry.outputs]]
        if not any(grads):
            continue
        wanted = [name in live for name in node.input]
        context = Context(graph, node, wanted)
        given = [*entry.rule(context, node, *grads)]
        given += [None] * (len(node.input) - len(given))
        for name, want, grad in zip(node.input, wanted, given, strict=True):
            if want:
                assert grad is not None, f"rule {node.op_type} gives no gradient of {name!r}"
                if entry.broadcasts:
                    grad = broadcast.unbroadcast(context, sizes, grad, name, entry.core_axes)
                pending.setdefault(name, []).append(grad)
    total = _total(graph, wrt, pending.get(wrt))
    assert total is not None, f"the gradient of {output!r} never reaches {wrt!r}"
    return total


def _total(graph: Graph, name: str, parts: list[str] | None) -> str | None:
    """The sum of what the readers of `name` sent back."""
    if not parts:
        return None
    if len(parts) > 1:
        parts[:] = [graph.op("Sum", *parts, name=f"{ADJOINT}{name}/accumulate")]
    return parts[0]
