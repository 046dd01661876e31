"""What an .onnx file holds, read without the onnx package: nodes, initializers, inputs and outputs.

The numbers of the fields below are those of onnx.proto; the file is one ``ModelProto`` message.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from elf_runtime.errors import ModelError, reason
from elf_runtime.files.kind import HEAD, description, open_regular

from .protobuf import Message, WireError

# TensorProto.DataType: name and bytes of an element (0.5: two to a byte); text has no fixed size.
DTYPES: dict[int, tuple[str, float]] = {
    1: ("float32", 4), 2: ("uint8", 1), 3: ("int8", 1), 4: ("uint16", 2), 5: ("int16", 2), 6: ("int32", 4),
    7: ("int64", 8), 8: ("string", 0), 9: ("bool", 1), 10: ("float16", 2), 11: ("float64", 8),
    12: ("uint32", 4), 13: ("uint64", 8), 14: ("complex64", 8), 15: ("complex128", 16), 16: ("bfloat16", 2),
    17: ("float8e4m3fn", 1), 18: ("float8e4m3fnuz", 1), 19: ("float8e5m2", 1), 20: ("float8e5m2fnuz", 1),
    21: ("uint4", 0.5), 22: ("int4", 0.5), 23: ("float4e2m1", 0.5),
}  # fmt: skip
_MAX_DEPTH = 32  # of graphs in the attributes of nodes (If, Loop, Scan)


@dataclass(frozen=True)
class Node:
    op: str
    name: str
    domain: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True)
class Tensor:
    """An initializer (`dims` all known), or a graph input or output (an int, a symbol, or "?" per axis)."""

    name: str
    dtype: str
    dims: tuple[int | str, ...]
    size: int = 0  # elements of an initializer
    nbytes: int = 0


@dataclass(frozen=True)
class OnnxFile:
    """The main graph, and the nodes and initializers of the graphs inside its nodes.

    Attributes
    ----------
    opsets : dict
        Domain -> version; ONNX's own domain is "ai.onnx".
    inputs : tuple of Tensor
        Without the initializers, which old files list among the inputs.
    """

    ir_version: int
    producer: str
    opsets: dict[str, int]
    nodes: tuple[Node, ...]
    initializers: tuple[Tensor, ...]
    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]
    metadata: dict[str, str]

    def __repr__(self) -> str:
        return f"OnnxFile({len(self.nodes)} nodes, {len(self.initializers)} initializers, opsets {self.opsets})"

    def op_counts(self) -> dict[str, int]:
        """Op -> number of nodes, the most frequent first; ops of other domains as ``domain.Op``."""
        names = [n.op if n.domain in ("", "ai.onnx") else f"{n.domain}.{n.op}" for n in self.nodes]
        return dict(sorted(Counter(names).items(), key=lambda item: (-item[1], item[0])))


def read_onnx(source: str | os.PathLike[str] | bytes) -> OnnxFile:
    """Read a model file, or its bytes.

    Raises
    ------
    ModelError
        If it can't be read, is cut off, or is no ONNX model.
    """
    name = "<model bytes>" if isinstance(source, bytes) else os.fsdecode(source)
    try:
        data = source if isinstance(source, bytes) else _content(source)
    except OSError as error:
        raise ModelError(f"{name}: {reason(error)}") from error
    try:
        return _model(memoryview(data))
    except WireError as error:
        what = description(data[:HEAD])
        why = f"it is {what}" if what else f"or cut off: {error}"
        raise ModelError(f"{name}: not an ONNX model{':' if what else ','} {why}") from None


def _content(path: str | os.PathLike[str]) -> bytes:
    with open_regular(path) as file:
        return file.read()


def has_external_data(data: bytes) -> bool:
    """Whether a model keeps tensors in files of their own: ONNX Runtime would look for them in the current folder.

    False for bytes that are no ONNX model.
    """
    if b"location" not in data:  # the key that names such a file
        return False
    try:
        model = Message(memoryview(data))
        bodies = [node for part in model.parts(25) for node in Message(part).parts(7)]  # of functions
        return any(map(_is_external, model.parts(7))) or _has_external_tensors(bodies, 0)
    except WireError:
        return False


def _is_external(data: memoryview, depth: int = 0) -> bool:
    """Whether a graph has such tensors: initializers, or in its nodes' attributes, at any depth."""
    graph = Message(data)
    stored = any(Message(part).integer(14) == 1 for part in graph.parts(5))
    return stored or _has_external_tensors(graph.parts(1), depth)


def _has_external_tensors(nodes: Iterable[memoryview], depth: int) -> bool:
    for attribute in (Message(part) for node in nodes for part in Message(node).parts(5)):
        if any(Message(part).integer(14) == 1 for part in (*attribute.parts(5), *attribute.parts(10))):
            return True
        inner = (*attribute.parts(6), *attribute.parts(11))
        if depth < _MAX_DEPTH and any(_is_external(part, depth + 1) for part in inner):
            return True
    return False


def _model(data: memoryview) -> OnnxFile:
    model = Message(data)
    opsets = {m.text(1) or "ai.onnx": m.integer(2) for m in map(Message, model.parts(8))}
    if 1 not in model or 7 not in model or not opsets:
        raise WireError("it has no IR version, graph or opset")
    graph = Message(model.parts(7)[-1])
    nodes: list[Node] = []
    initializers: list[Tensor] = []
    _collect(graph, nodes, initializers, 0)
    stored = {tensor.name for tensor in initializers}
    return OnnxFile(
        ir_version=model.integer(1),
        producer=" ".join(filter(None, (model.text(2), model.text(3)))),
        opsets=opsets,
        nodes=tuple(nodes),
        initializers=tuple(initializers),
        inputs=tuple(v for v in map(_value, graph.parts(11)) if v.name not in stored),
        outputs=tuple(map(_value, graph.parts(12))),
        metadata={m.text(1): m.text(2) for m in map(Message, model.parts(14))},
    )


def _collect(graph: Message, nodes: list[Node], initializers: list[Tensor], depth: int) -> None:
    if depth > _MAX_DEPTH:
        raise WireError(f"graphs are nested more than {_MAX_DEPTH} deep")
    initializers.extend(_initializer(Message(part)) for part in graph.parts(5))
    for node in map(Message, graph.parts(1)):
        inputs, outputs = tuple(node.texts(1)), tuple(node.texts(2))
        nodes.append(Node(node.text(4), node.text(3), node.text(7), inputs, outputs))
        for attribute in map(Message, node.parts(5)):
            for part in (*attribute.parts(6), *attribute.parts(11)):
                _collect(Message(part), nodes, initializers, depth + 1)


def _initializer(tensor: Message) -> Tensor:
    dims = tensor.integers(1)
    size = 1
    for dim in dims:
        if dim < 0:
            raise WireError(f"initializer {tensor.text(8)!r} has the shape {dims}")
        size *= dim
    dtype, width = DTYPES.get(tensor.integer(2), (f"type {tensor.integer(2)}", 0))
    return Tensor(tensor.text(8), dtype, tuple(dims), size, int(size * width))


def _value(data: memoryview) -> Tensor:
    value = Message(data)
    types = [Message(part) for part in value.parts(2)]
    tensors = [Message(part) for kind in types for part in kind.parts(1)]
    if not tensors:
        return Tensor(value.text(1), "not a tensor", ())
    shapes = [Message(part) for part in tensors[-1].parts(2)]
    dims = [Message(part) for shape in shapes for part in shape.parts(1)]
    found = tuple(dim.integer(1) if 1 in dim else dim.text(2) or "?" for dim in dims)
    return Tensor(value.text(1), DTYPES.get(tensors[-1].integer(1), ("unknown", 0))[0], found)
