"""Where the nodes that belong to one node go, and what they may ask of the graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from onnx import helper

from elf_export.graph.graph import Array, Dim, Graph, attributes
from elf_export.graph.nodes import OWN


class Emitter:
    """Emits nodes and constants for `node`, named ``PREFIX/<role>``.

    Shapes and dtypes are asked of values that were there before.
    """

    def __init__(self, graph: Graph, node: onnx.NodeProto, prefix: str) -> None:
        self.graph = graph
        self.node = node
        self.prefix = prefix
        self.attrs = attributes(node)

    @property
    def opset(self) -> int:
        return self.graph.opset

    def op(self, op_type: str, *inputs: str, role: str | None = None, **attrs: Any) -> str:
        """Emit a node and return its (first) output."""
        return self.graph.op(op_type, *inputs, name=self.name(role or op_type.lower()), **attrs)

    def own(self, op_type: str, *inputs: str, role: str, **attrs: Any) -> str:
        """Emit an operation of `dialect`."""
        if not any(entry.domain == OWN for entry in self.graph.model.opset_import):
            self.graph.model.opset_import.append(helper.make_opsetid(OWN, 1))
        return self.op(op_type, *inputs, role=role, domain=OWN, **attrs)

    def const(self, value: Any, role: str, like: str | None = None, dtype: np.dtype[Any] | None = None) -> str:
        """Emit a constant; of the dtype of the forward value `like`, or of `dtype`, if given."""
        dtype = self.graph.dtype(like) if like is not None else dtype
        return self.graph.const(value, self.name(role), dtype)

    def int64s(self, values: Sequence[int], role: str) -> str:
        return self.graph.int64s(values, self.name(role))

    def input(self, index: int) -> str:
        """Name of an optional input, empty if it is absent."""
        return str(self.node.input[index]) if index < len(self.node.input) else ""

    def value(self, name: str) -> Array | None:
        """The value of a constant input, None if it is computed."""
        return self.graph.constant(name)

    def shape(self, name: str) -> list[Dim] | None:
        return self.graph.shape(name)

    def rank(self, name: str) -> int:
        """Rank of a value, which must be known."""
        rank = self.graph.rank(name)
        assert rank is not None, f"unknown rank of {name!r}"
        return rank

    def dtype(self, name: str) -> np.dtype[Any]:
        return self.graph.dtype(name)

    def name(self, role: str) -> str:
        """The name of what is emitted in that role."""
        return f"{self.prefix}/{role}"
