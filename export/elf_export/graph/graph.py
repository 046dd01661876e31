"""A model under construction: nodes are appended, put before others, replaced and removed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper, numpy_helper

from .nodes import (
    SIZES,
    Array,
    Dim,
    attributes,
    bodies,
    call_otherwise,
    captured,
    defined_in,
    is_standard,
    names_in,
    nested_graphs,
    read_instead,
    reads,
)
from .view import GraphView

__all__ = [
    "SIZES", "Array", "Dim", "Graph", "GraphView", "attributes", "bodies", "captured", "defined_in", "is_standard",
    "nested_graphs", "reduce_mean",
]  # fmt: skip


class Graph(GraphView):
    """An ONNX model that can be edited.

    Who makes and reads a value is known after every edit.  Of values that an edit adds, shapes are inferred when one
    is asked for.  Nodes that take another node's place make the same values as it, of the same type; an edit
    that makes something else of a value says so with `retype`.

    Parameters
    ----------
    model : onnx.ModelProto
        Copied; the original is left alone.
    copy : bool
        False edits `model` itself, which must be nobody else's.
    """

    def __init__(self, model: onnx.ModelProto, copy: bool = True) -> None:
        if copy:
            read, model = model, onnx.ModelProto()
            model.CopyFrom(read)
        self._names = names_in(model.graph)
        self._before: onnx.NodeProto | None = None
        super().__init__(model)

    # -- adding ----------------------------------------------------------------------------------------------

    def unique(self, wanted: str) -> str:
        """`wanted`, or `wanted` with a number behind it if the graph uses the name already, or has used it."""
        name, count = wanted, 1
        while name in self._names:
            count += 1
            name = f"{wanted}_{count}"
        self._names.add(name)
        return name

    def op(self, op_type: str, *inputs: str, name: str, outputs: int | Sequence[str] = 1, **attributes: Any) -> str:
        """Add a node, last or where `insert_before` and `replace_node` say; returns the name of its first output.

        That is the node's own name, unless `outputs` names them.
        """
        name = self.unique(name)
        if isinstance(outputs, int):
            outs = [name, *(self.unique(f"{name}/{i}") for i in range(1, outputs))]
        else:
            outs = list(outputs)
            self._names.update(outs)
        given = {key: value for key, value in attributes.items() if value is not None}
        self.add(helper.make_node(op_type, list(inputs), outs, name=name, **given))
        return outs[0]

    def add(self, node: onnx.NodeProto) -> onnx.NodeProto:
        """Add a copy of a node as it is, where `op` would."""
        nodes = self.model.graph.node
        at = len(nodes) if self._before is None else self._place(self._before)
        nodes.insert(at, node)
        added: onnx.NodeProto = nodes[at]
        self._enter(added)
        self._notice(added)
        return added

    def const(self, value: npt.ArrayLike, name: str, dtype: npt.DTypeLike | None = None) -> str:
        """Add an initializer and return its name."""
        name = self.unique(name)
        array = np.ascontiguousarray(np.asarray(value, dtype)).reshape(np.shape(value))
        return self._initialize(name, array)

    def int64s(self, values: Iterable[int], name: str) -> str:
        return self.const(np.array(list(values), np.int64), name)

    def _initialize(self, name: str, array: Array) -> str:
        tensors = self.model.graph.initializer
        tensors.append(numpy_helper.from_array(array, name))
        self._constants[name], self._arrays[name] = tensors[-1], array
        return name

    # -- editing ---------------------------------------------------------------------------------------------

    @contextmanager
    def insert_before(self, node: onnx.NodeProto | None) -> Iterator[None]:
        """What is added inside the block comes before `node`; at the end if that is None."""
        outer, self._before = self._before, node
        try:
            yield
        finally:
            self._before = outer

    @contextmanager
    def replace_node(self, node: onnx.NodeProto) -> Iterator[None]:
        """What is added inside the block takes the place of `node`, and must make those of its outputs that are read.

        The node's fields can still be read.
        """
        at = self._place(node)
        after = self.nodes[at + 1] if at + 1 < len(self.nodes) else None
        self.remove(node)
        with self.insert_before(after):
            yield

    def remove(self, node: onnx.NodeProto) -> None:
        """Take a node out; who reads its outputs is for the caller to see to."""
        self._leave(node)
        del self.model.graph.node[self._place(node)]

    def move_before(self, node: onnx.NodeProto, other: onnx.NodeProto) -> None:
        """Put a node in front of another one."""
        copy = onnx.NodeProto()
        copy.CopyFrom(node)
        self.remove(node)
        with self.insert_before(other):
            self.add(copy)

    def rewire(
        self, node: onnx.NodeProto, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None
    ) -> None:
        """Change what a node reads, and what its results are called."""
        self._leave(node)
        for field, names in ((node.input, inputs), (node.output, outputs)):
            if names is not None:
                field[:] = names
        self._enter(node)
        self._notice(node)

    def replace_uses(self, old: str, new: str) -> None:
        """Let all nodes that read `old` read `new`, bodies included; an output of the graph keeps its name."""
        for node in list(self._consumers.get(old, ())):
            self._leave(node)
            read_instead(node, old, new)
            self._enter(node)

    def rename(self, names: Mapping[str, str]) -> None:
        """Call values otherwise, old name -> new name, wherever they are named; in bodies too."""
        call_otherwise(self.model.graph, names)
        self.reindex()

    def reindex(self) -> None:
        """Read the model again, after it was edited by hand."""
        self._index()
        self._types = None

    def replace_by_constant(self, node: onnx.NodeProto, value: Array) -> None:
        """Put an initializer in the place of a node of one output, whose value it is."""
        (name,) = node.output
        self.remove(node)
        self._initialize(name, value)
        self.retype(name)

    def retype(self, *names: str) -> None:
        """Infer the types of these values, and of all that is computed from them, again when they are asked for."""
        found: set[str] = set()
        stack = list(names)
        while stack:
            name = stack.pop()
            if name and name not in found:
                found.add(name)
                stack += [made for node in self._consumers.get(name, ()) for made in node.output]
        if self._types is not None:
            self._types = {name: kind for name, kind in self._types.items() if name not in found}
            self._unseen |= found

    def prune(self) -> None:
        """Remove what the graph's outputs don't need: nodes, constants and inputs.

        Raises
        ------
        KeyError
            If nothing makes one of them.
        """
        needed = self.needed(self.outputs)
        proto = self.model.graph
        for at in reversed(range(len(proto.node))):
            if not needed.intersection(proto.node[at].output):
                self._leave(proto.node[at])
                del proto.node[at]
        for field in (proto.initializer, proto.input, proto.value_info):
            for at in reversed(range(len(field))):
                if field[at].name not in needed:
                    del field[at]
        self._constants = {name: tensor for name, tensor in self._constants.items() if name in needed}
        self._arrays = {name: array for name, array in self._arrays.items() if name in needed}

    def set_outputs(self, outputs: Sequence[onnx.ValueInfoProto]) -> None:
        del self.model.graph.output[:]
        self.model.graph.output.extend(outputs)

    def _notice(self, node: onnx.NodeProto) -> None:
        """Note the values of a node that were not there when shapes were inferred."""
        if self._types is not None:
            self._unseen.update(name for name in node.output if name not in self._types)

    def _place(self, node: onnx.NodeProto) -> int:
        return next(at for at, other in enumerate(self.model.graph.node) if other is node)

    def _leave(self, node: onnx.NodeProto) -> None:
        """Forget what a node makes and reads."""
        for name in filter(None, node.output):
            if self._producers.get(name) is node:
                del self._producers[name]
                if node.op_type == "Constant":
                    self._constants.pop(name, None)
                    self._arrays.pop(name, None)
        for name in reads(node):
            readers = [other for other in self._consumers.get(name, ()) if other is not node]
            if readers:
                self._consumers[name] = readers
            else:
                self._consumers.pop(name, None)


def reduce_mean(graph: Graph, x: str, axis: int, name: str, keepdims: int, output: str | None = None) -> str:
    """Add ReduceMean over one axis, in the form of the graph's opset (axes are an input from 18 on)."""
    outputs: int | list[str] = 1 if output is None else [output]
    if graph.opset >= 18:
        axes = graph.int64s([axis], f"{name}_axes")
        return graph.op("ReduceMean", x, axes, name=name, outputs=outputs, keepdims=keepdims)
    return graph.op("ReduceMean", x, name=name, outputs=outputs, axes=[axis], keepdims=keepdims)
