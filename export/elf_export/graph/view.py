"""A model as passes and rules read it: who makes a value, who reads it, its shape, its value if it is constant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

from .ceil_mode import in_floor_mode, rounds_up
from .nodes import Array, Dim, captured, constant_of, copy_fields, reads
from .shapes import Types, dims_of, infer, shape_source


class GraphView:
    """A model's main graph, to be read.

    Values are known by name, as in ONNX itself; the empty name is an absent optional input.  Shapes are inferred when
    the first one is asked for.

    Parameters
    ----------
    model : onnx.ModelProto
        Not copied, and not changed.  Pools whose sizes ONNX's inference gets wrong make an exception: then it is a
        copy that is read, in which they are written so that inference gets them right (see `ceil_mode`).
    """

    def __init__(self, model: onnx.ModelProto) -> None:
        self.model = model
        self.opset = next((o.version for o in model.opset_import if o.domain in ("", "ai.onnx")), 0)
        self._types: Types | None = None
        self._runs = 0
        self._unseen: set[str] = set()  # values that were made, or became other ones, since shapes were inferred
        self._index()
        if any(map(rounds_up, self.nodes)):
            self._round_down()

    def _index(self) -> None:
        """Find out who makes and reads what."""
        self._producers: dict[str, onnx.NodeProto] = {}
        self._consumers: dict[str, list[onnx.NodeProto]] = {}
        self._constants = {tensor.name: tensor for tensor in self.model.graph.initializer}
        self._arrays: dict[str, Array] = {}
        for node in self.nodes:
            self._enter(node)

    def _enter(self, node: onnx.NodeProto) -> None:
        """Note what a node makes and reads."""
        for name in filter(None, node.output):
            self._producers[name] = node
        for name in reads(node):
            self._consumers.setdefault(name, []).append(node)
        tensor = constant_of(node)
        if tensor is not None:
            self._constants[node.output[0]] = tensor

    # -- nodes and values ------------------------------------------------------------------------------------

    @property
    def nodes(self) -> Sequence[onnx.NodeProto]:
        nodes: Sequence[onnx.NodeProto] = self.model.graph.node
        return nodes

    @property
    def inputs(self) -> list[str]:
        return [value.name for value in self.model.graph.input]

    @property
    def outputs(self) -> list[str]:
        return [value.name for value in self.model.graph.output]

    def producers(self) -> Mapping[str, onnx.NodeProto]:
        """Value name -> the node that makes it."""
        return self._producers

    def consumers(self) -> Mapping[str, Sequence[onnx.NodeProto]]:
        """Value name -> the nodes that read it, be it from inside a body; a node that reads it twice is there twice."""
        return self._consumers

    def constant(self, name: str) -> Array | None:
        """The value of a constant, or None if `name` is computed."""
        if name not in self._constants:
            return None
        if name not in self._arrays:
            self._arrays[name] = numpy_helper.to_array(self._constants[name])
        return self._arrays[name]

    def is_constant(self, name: str) -> bool:
        return name in self._constants

    def needed(self, outputs: Sequence[str]) -> set[str]:
        """`outputs` and all values that they are computed from.

        Raises
        ------
        KeyError
            If nothing makes one of them.
        """
        inputs = set(self.inputs)
        found: set[str] = set()
        stack = list(outputs)
        while stack:
            name = stack.pop()
            if not name or name in found:
                continue
            found.add(name)
            if name in self._producers:
                node = self._producers[name]
                stack.extend(node.input)
                stack.extend(captured(node))
            elif name not in inputs and not self.is_constant(name):
                raise KeyError(name)
        return found

    def part(self, outputs: Sequence[str]) -> onnx.ModelProto:
        """A new model that computes `outputs`, without the nodes, constants and inputs that they don't need.

        Raises
        ------
        KeyError
            If nothing makes one of them.
        """
        needed = self.needed(outputs)
        result, source = onnx.ModelProto(), self.model.graph
        proto = result.graph
        filtered = ("input", "initializer", "value_info")
        copy_fields(self.model, result, without=["graph"])
        copy_fields(source, proto, without=["node", "output", *filtered])
        proto.node.extend(node for node in source.node if needed.intersection(node.output))
        for field in filtered:
            getattr(proto, field).extend(value for value in getattr(source, field) if value.name in needed)
        stated = {value.name: value for value in source.output}
        for name in outputs:
            typed = stated.get(name)
            proto.output.append(typed or helper.make_tensor_value_info(name, self.elem_type(name), self.shape(name)))
        return result

    # -- types -----------------------------------------------------------------------------------------------

    def _type(self, name: str) -> onnx.TypeProto.Tensor | None:
        if self._types is not None and name in self._types:
            return self._types[name]
        for value in self.model.graph.input:  # nothing has to be inferred for those
            if value.name == name:
                return value.type.tensor_type if value.type.HasField("tensor_type") else None
        if self._types is None or name in self._unseen:
            self._types = infer(self.model, self._producers, self._runs)
            self._unseen.clear()
            self._runs += 1
        return self._types.get(name)

    def shape(self, name: str) -> list[Dim] | None:
        """Sizes: an int where static, a name where symbolic, None where unknown; None for an unknown rank."""
        if name in self._constants:
            return list(self._constants[name].dims)
        return dims_of(self._type(name))

    def rank(self, name: str) -> int | None:
        shape = self.shape(name)
        return None if shape is None else len(shape)

    def elem_type(self, name: str) -> int:
        """onnx.TensorProto.DataType of a value; FLOAT where inference does not tell."""
        if name in self._constants:
            return int(self._constants[name].data_type)
        kind = self._type(name)
        return int(kind.elem_type) if kind is not None and kind.elem_type else int(onnx.TensorProto.FLOAT)

    def dtype(self, name: str) -> np.dtype[Any]:
        return np.dtype(helper.tensor_dtype_to_np_dtype(self.elem_type(name)))

    def shape_source(self, node: onnx.NodeProto) -> str | None:
        """A value whose shape the node's output has, where ONNX's inference would not tell."""
        return shape_source(node, self._producers)

    def _round_down(self) -> None:
        """Write the pools in ceil_mode in floor mode where ONNX's inference gets their sizes wrong."""
        read, self.model = self.model, onnx.ModelProto()
        self.model.CopyFrom(read)
        self._index()
        for pool in filter(rounds_up, self.nodes):
            sizes = [size for size in (self.shape(pool.input[0]) or [])[2:] if isinstance(size, int)]
            if not in_floor_mode(pool, sizes):
                continue
            # What the file states of the sizes behind the pool is what inference would have said.
            del self.model.graph.value_info[:]
            for output in self.model.graph.output:
                output.type.tensor_type.ClearField("shape")
            self._types = infer(self.model, self._producers)
            for output in self.model.graph.output:
                if output.name in self._types:
                    output.type.tensor_type.CopyFrom(self._types[output.name])
