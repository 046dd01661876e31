"""From what a user calls a layer to the value in the graph."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import onnx

from elf_export.errors import LayerError

SHOWN = 8  # near matches in a message


def resolve_layer(model: onnx.ModelProto, wanted: str) -> str:
    """The value that `wanted` names: a value's name, a node's (its first output), or a unique end of one.

    Raises
    ------
    LayerError
        If nothing or more than one value is called so; the message lists the nearest names.
    """
    if not wanted:
        raise LayerError("a layer's name is empty")
    values = {str(name) for node in model.graph.node for name in node.output if name}
    if wanted in values:
        return wanted
    called: dict[str, set[str]] = {name: {name} for name in values}
    for node in model.graph.node:
        if node.name and node.output:
            called.setdefault(node.name, set()).add(node.output[0])
    by_node = {str(node.output[0]) for node in model.graph.node if node.name == wanted and node.output}
    found = by_node or {value for name, ends in called.items() if name.endswith(wanted) for value in ends}
    if len(found) == 1:
        return found.pop()
    if found:
        raise LayerError(
            f"{wanted!r} is the end of {len(found)} layers' names: {_some(sorted(found))}; give more of the name"
        )
    inside = sorted(name for name in called if wanted.lower() in name.lower())
    near = inside or difflib.get_close_matches(wanted, list(called), SHOWN, 0.4)
    hint = f"nearest are {_some(near)}" if near else "no name is like it"
    raise LayerError(f"the model has no layer {wanted!r}; {hint} (--list shows all)")


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(repr(name) for name in names[:SHOWN]) + more
