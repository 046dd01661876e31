"""Keep of a model only what the wanted values need."""

from __future__ import annotations

from collections.abc import Sequence

import onnx
from onnx import helper

from elf_export.graph.graph import Graph, captured


def cut(model: onnx.ModelProto, outputs: Sequence[str]) -> onnx.ModelProto:
    """A copy of `model` whose outputs are `outputs`, without the nodes and initializers that they don't need.

    Parameters
    ----------
    outputs : names of values of the main graph

    Raises
    ------
    KeyError
        If nothing makes one of them.
    """
    graph = Graph(model)
    producers = graph.producers()
    inputs = {value.name for value in model.graph.input}
    needed: set[str] = set()
    stack = list(outputs)
    while stack:
        name = stack.pop()
        if not name or name in needed:
            continue
        needed.add(name)
        if name in producers:
            node = producers[name]
            stack.extend(node.input)
            stack.extend(captured(node))
        elif name not in inputs and not graph.is_constant(name):
            raise KeyError(name)

    result = graph.model
    nodes = [node for node in result.graph.node if needed.intersection(node.output)]
    initializers = [tensor for tensor in result.graph.initializer if tensor.name in needed]
    kept_inputs = [value for value in result.graph.input if value.name in needed]
    kept_infos = [value for value in result.graph.value_info if value.name in needed]
    old_outputs = {value.name: value for value in result.graph.output}
    new_outputs = [
        old_outputs.get(name) or helper.make_tensor_value_info(name, graph.elem_type(name), graph.shape(name))
        for name in outputs
    ]
    proto = result.graph
    for field, kept in (
        (proto.node, nodes),
        (proto.initializer, initializers),
        (proto.input, kept_inputs),
        (proto.value_info, kept_infos),
        (proto.output, new_outputs),
    ):
        copies = [type(item)() for item in kept]
        for copy, item in zip(copies, kept, strict=True):
            copy.CopyFrom(item)
        del field[:]
        field.extend(copies)
    return result
