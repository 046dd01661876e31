"""What one node or one GraphProto says by itself: attributes, bodies, the names that it defines."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper, numpy_helper

Dim = int | str | None
Array = npt.NDArray[Any]

Proto = TypeVar("Proto", onnx.ModelProto, onnx.GraphProto)

OWN = "elf"  # the domain of the exporter's own operations (see `dialect`); no finished graph has any
SIZES = frozenset({"Shape", "Size"})  # ops whose output depends on a map's size only


def attributes(node: onnx.NodeProto) -> dict[str, Any]:
    """A node's attributes as Python values; text as str."""
    values = {a.name: helper.get_attribute_value(a) for a in node.attribute}
    return {k: v.decode(errors="replace") if isinstance(v, bytes) else v for k, v in values.items()}


def is_standard(node: onnx.NodeProto) -> bool:
    return node.domain in ("", "ai.onnx")


def reads(node: onnx.NodeProto) -> list[str]:
    """The values that a node reads, once for each time; those that its bodies take from outside too."""
    return [name for name in (*node.input, *captured(node)) if name]


def captured(node: onnx.NodeProto) -> list[str]:
    """Names that a control-flow node's bodies read from outside; what a body defines itself is not among them."""
    names: list[str] = []
    for body in bodies(node):
        own = set(defined_in(body))
        read = [value.name for value in body.output]
        for inner in body.node:
            read += [*inner.input, *captured(inner)]
        names += [name for name in dict.fromkeys(read) if name and name not in own]
    return names


def bodies(node: onnx.NodeProto) -> list[onnx.GraphProto]:
    """The graphs that a control-flow node runs."""
    found = []
    for attribute in node.attribute:
        found += [attribute.g] if attribute.HasField("g") else []
        found += attribute.graphs
    return found


def defined_in(graph: onnx.GraphProto) -> list[str]:
    """The names of a graph's values: its inputs, its constants and what its nodes make; not those of its bodies."""
    names = [value.name for value in graph.input]
    names += [tensor.name for tensor in graph.initializer]
    names += [tensor.values.name for tensor in graph.sparse_initializer]
    names += [name for node in graph.node for name in node.output]
    return [name for name in names if name]


def nested_graphs(graph: onnx.GraphProto) -> Iterator[onnx.GraphProto]:
    """`graph` and the bodies of its control-flow nodes, outermost first."""
    yield graph
    for node in graph.node:
        for body in bodies(node):
            yield from nested_graphs(body)


def names_in(graph: onnx.GraphProto) -> set[str]:
    """All names that are taken; those inside bodies too, which may not define a name of the graph around them."""
    names = {node.name for node in graph.node}
    for inner in nested_graphs(graph):
        names.update(defined_in(inner))
    return names | {name for node in graph.node for name in node.input}


def call_otherwise(graph: onnx.GraphProto, names: Mapping[str, str]) -> None:
    """Rename values, old name -> new name, wherever a graph or a body in it names them."""
    for inner in nested_graphs(graph):
        for value in (*inner.input, *inner.output, *inner.value_info, *inner.initializer):
            value.name = names.get(value.name, value.name)
        for sparse in inner.sparse_initializer:
            sparse.values.name = names.get(sparse.values.name, sparse.values.name)
        for node in inner.node:
            for ends in (node.input, node.output):
                ends[:] = [names.get(name, name) for name in ends]


def read_instead(node: onnx.NodeProto, old: str, new: str) -> None:
    """Let a node read `new` where it reads `old`, and its bodies too."""
    node.input[:] = [new if name == old else name for name in node.input]
    for body in bodies(node):
        for inner in body.node:
            read_instead(inner, old, new)
        for value in body.output:
            value.name = new if value.name == old else value.name


def constant_of(node: onnx.NodeProto) -> onnx.TensorProto | None:
    """The tensor of a Constant node; None for any other node, and where it is sparse or text."""
    if node.op_type != "Constant":
        return None
    kinds = {
        "value_float": np.float32,
        "value_floats": np.float32,
        "value_int": np.int64,
        "value_ints": np.int64,
    }
    for name, value in attributes(node).items():
        if name == "value":
            assert isinstance(value, onnx.TensorProto)
            return value
        if name in kinds:
            return numpy_helper.from_array(np.asarray(value, kinds[name]), node.output[0])
    return None


def copy_fields(source: Proto, target: Proto, without: Collection[str]) -> None:
    """Copy what `source` states into an empty `target`, but for the fields `without`."""
    for field, value in source.ListFields():
        if field.name in without:
            continue
        if hasattr(value, "extend"):
            getattr(target, field.name).extend(value)
        else:
            setattr(target, field.name, value)
