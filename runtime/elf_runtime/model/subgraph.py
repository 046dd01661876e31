"""A model cut down to some of its outputs, without the onnx package.

ONNX Runtime computes every output of a graph, whichever are fetched: ``only_execute_path_to_fetches`` works
in its training builds only (https://github.com/microsoft/onnxruntime/issues/16013).  To compute the saliency
alone, without the deeper layers of the descriptors, takes a model that has no other output.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from elf_runtime.errors import ModelError

from .protobuf import Message, WireError, encoded, raw_fields

# Field numbers of onnx.proto.
_MODEL_GRAPH = 7
_GRAPH_NODE, _GRAPH_INITIALIZER, _GRAPH_OUTPUT = 1, 5, 12
_NODE_INPUT, _NODE_OUTPUT, _NODE_ATTRIBUTE = 1, 2, 5
_TENSOR_NAME, _VALUE_NAME = 8, 1


def with_outputs(source: str | os.PathLike[str] | bytes, outputs: Sequence[str], name: str = "<model bytes>") -> bytes:
    """The model with only these of its outputs, and the nodes and initializers that they need.

    All else (opsets, metadata, inputs) stays as it is, byte for byte.  `name` is for messages, where the model is given
    as bytes.

    Raises
    ------
    ModelError
        If the file can't be read, is no model, lacks one of the outputs, or has nodes with graphs of their
        own (which may read any value from outside).
    """
    name = name if isinstance(source, bytes) else os.fspath(source)
    try:
        data = source if isinstance(source, bytes) else Path(source).read_bytes()
        return b"".join(
            encoded(number, _cut(value, outputs, name))
            if number == _MODEL_GRAPH and isinstance(value, memoryview)
            else bytes(raw)
            for number, value, raw in raw_fields(memoryview(data))
        )
    except OSError as error:
        raise ModelError(f"{name}: {error.strerror or error}") from error
    except WireError as error:
        raise ModelError(f"{name}: not an ONNX model, or cut off: {error}") from None


def _cut(data: memoryview, outputs: Sequence[str], name: str) -> bytes:
    graph = Message(data)
    known = {Message(part).text(_VALUE_NAME) for part in graph.parts(_GRAPH_OUTPUT)}
    for output in outputs:
        if output not in known:
            raise ModelError(f"{name}: has no output {output!r}; it has {sorted(known)}")
    nodes = [Message(part) for part in graph.parts(_GRAPH_NODE)]
    needed, kept = set(outputs), set()
    # The nodes stand in topological order, so that one pass from the last to the first finds all.
    for index in range(len(nodes) - 1, -1, -1):
        node = nodes[index]
        if needed.isdisjoint(node.texts(_NODE_OUTPUT)):
            continue
        if any(6 in attribute or 11 in attribute for attribute in map(Message, node.parts(_NODE_ATTRIBUTE))):
            raise ModelError(f"{name}: node {node.text(3)!r} ({node.text(4)}) has a graph of its own")
        kept.add(index)
        needed.update(node.texts(_NODE_INPUT))
    rows = []
    position = -1
    for number, value, raw in raw_fields(data):
        if number == _GRAPH_NODE:
            position += 1
            keep = position in kept
        elif number == _GRAPH_INITIALIZER and isinstance(value, memoryview):
            keep = Message(value).text(_TENSOR_NAME) in needed
        elif number == _GRAPH_OUTPUT and isinstance(value, memoryview):
            keep = Message(value).text(_VALUE_NAME) in outputs
        else:
            keep = True
        if keep:
            rows.append(bytes(raw))
    return b"".join(rows)
