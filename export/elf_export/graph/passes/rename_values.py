"""Give values of a model other names."""

from __future__ import annotations

from collections.abc import Mapping

import onnx

from elf_export.graph.graph import nested_graphs


def rename_values(model: onnx.ModelProto, names: Mapping[str, str]) -> onnx.ModelProto:
    """A copy of `model` in which each value of `names`, old name -> new name, is called by its new one.

    Bodies of control-flow nodes read outer values by name, and may not define one of the same name: there too.
    """
    result = onnx.ModelProto()
    result.CopyFrom(model)
    for graph in nested_graphs(result.graph):
        for value in (*graph.input, *graph.output, *graph.value_info, *graph.initializer):
            value.name = names.get(value.name, value.name)
        for sparse in graph.sparse_initializer:
            sparse.values.name = names.get(sparse.values.name, sparse.values.name)
        for node in graph.node:
            for ends in (node.input, node.output):
                ends[:] = [names.get(name, name) for name in ends]
    return result
