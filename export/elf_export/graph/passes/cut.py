"""Keep of a model only what the wanted values need."""

from __future__ import annotations

from collections.abc import Sequence

import onnx

from elf_export.graph.graph import GraphView


def cut(model: onnx.ModelProto, outputs: Sequence[str]) -> onnx.ModelProto:
    """A new model whose outputs are `outputs`, without the nodes, constants and inputs that they don't need.

    requires : `outputs` are names of values of the main graph.
    call : ``cut(model, ["pool2"])``; `Graph.prune` is for a graph that is being edited.
    ensures : `model` is not changed; what is left keeps its order.

    Raises
    ------
    KeyError
        If nothing makes one of them.
    """
    return GraphView(model).part(outputs)
