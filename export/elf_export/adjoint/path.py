"""Which nodes lie on a differentiable path between two values."""

from __future__ import annotations

import onnx

from elf_export.graph.graph import GraphView, captured

from .registry import has_no_gradient, is_floating, is_straight_through


def nodes_between(graph: GraphView, source: str, target: str) -> list[onnx.NodeProto]:
    """The nodes on any differentiable path from `source` to `target`, in graph order."""
    return trace(graph, source, target)[0]


def trace(graph: GraphView, source: str, target: str) -> tuple[list[onnx.NodeProto], set[str]]:
    """The nodes on the differentiable paths, and the values on them."""
    able, reached = reach(graph, source)
    live, path = {target} & reached, []
    for node in reversed(able):
        if live.intersection(node.output) and source not in node.output:
            path.append(node)
            live.update(reached.intersection((*node.input, *captured(node))))
    return path[::-1], live


def reach(graph: GraphView, source: str) -> tuple[list[onnx.NodeProto], set[str]]:
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
