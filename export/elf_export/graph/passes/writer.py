"""Nodes that stand for one node: all are called by its name, and the last one makes its result."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper

from elf_export.graph.graph import Array, Graph

MICROSOFT = "com.microsoft"


class Writer:
    """Adds what takes the place of `node`, of one output.

    Attributes
    ----------
    graph : Graph
        Inside `Graph.replace_node`.
    """

    def __init__(self, graph: Graph, node: onnx.NodeProto) -> None:
        self.graph, self.node = graph, node
        self.prefix, self.result = str(node.name or node.output[0]), str(node.output[0])

    def input(self, index: int) -> str:
        """Name of an input, empty if it is left out."""
        return str(self.node.input[index]) if index < len(self.node.input) else ""

    def op(self, op_type: str, *inputs: str, role: str = "", **given: Any) -> str:
        """A node; without a role it makes the result."""
        while inputs and not inputs[-1]:
            inputs = inputs[:-1]
        if role:
            return self.graph.op(op_type, *inputs, name=f"{self.prefix}/{role}", **given)
        kept = {key: value for key, value in given.items() if value is not None}
        self.graph.add(helper.make_node(op_type, inputs, [self.result], name=self.prefix, **kept))
        return self.result

    def const(self, value: npt.ArrayLike, role: str) -> str:
        return self.graph.const(value, f"{self.prefix}/{role}", np.float32)

    def value(self, name: str) -> Array | None:
        return self.graph.constant(name)
