"""A model as the passes and the adjoint see it: who makes a value, its shape, and a way to append nodes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper, numpy_helper, shape_inference

from .ceil_mode import CEIL_POOLS, floor_mode_pads

Dim = int | str | None
Array = npt.NDArray[Any]

SIZES = frozenset({"Shape", "Size"})  # ops whose output depends on a map's size only


class Graph:
    """An ONNX model under construction.

    Reads the nodes, constants and inferred shapes of a ModelProto and appends to it.  Values are known by
    name, as in ONNX itself; the empty name is an absent optional input.

    Parameters
    ----------
    model : onnx.ModelProto
        Copied; the original is left alone.  Only its main graph is looked at.  Pools whose sizes ONNX's inference
        gets wrong are written so that it gets them right, see `ceil_mode`.
    """

    def __init__(self, model: onnx.ModelProto) -> None:
        self.model = onnx.ModelProto()
        self.model.CopyFrom(model)
        self.opset = next((o.version for o in model.opset_import if o.domain in ("", "ai.onnx")), 0)
        self._constants = {t.name: t for t in self.model.graph.initializer}
        self._arrays: dict[str, Array] = {}
        self._names = {n.name for n in self.model.graph.node}
        for graph in nested_graphs(self.model.graph):  # a body may not define a name of the graph around it
            self._names.update(defined_in(graph))
        self._names.update(v for n in self.model.graph.node for v in n.input)
        for node in self.model.graph.node:
            tensor = _constant_of(node) if node.op_type == "Constant" else None
            if tensor is not None:
                self._constants[node.output[0]] = tensor
        self._types: dict[str, onnx.TypeProto.Tensor] = {}
        self._producers = self.producers()
        self.infer_shapes()
        for node in self.nodes:
            if node.op_type in CEIL_POOLS:
                self._round_down(node)

    # -- reading ---------------------------------------------------------------------------------------------

    @property
    def nodes(self) -> Sequence[onnx.NodeProto]:
        nodes: Sequence[onnx.NodeProto] = self.model.graph.node
        return nodes

    def producers(self) -> dict[str, onnx.NodeProto]:
        """Value name -> the node that makes it."""
        return {name: node for node in self.nodes for name in node.output if name}

    def consumers(self) -> dict[str, list[onnx.NodeProto]]:
        """Value name -> the nodes that read it, be it from inside a body."""
        readers: dict[str, list[onnx.NodeProto]] = {}
        for node in self.nodes:
            for name in (*node.input, *captured(node)):
                readers.setdefault(name, []).append(node)
        return readers

    def infer_shapes(self) -> None:
        """Refresh what `shape`, `rank` and `dtype` answer from, after nodes were appended or removed."""
        while True:
            inferred = shape_inference.infer_shapes(self.model, data_prop=True).graph
            for value in (*inferred.value_info, *inferred.output, *inferred.input):
                if value.type.HasField("tensor_type"):
                    self._types[value.name] = value.type.tensor_type
            news = [node for node in self.nodes if self._learn(node)]
            if not news:
                break

    def _learn(self, node: onnx.NodeProto) -> bool:
        """State what ONNX's inference does not find of a node's output; whether that was news."""
        name = node.output[0] if node.output else ""
        if not name or self.rank(name) is not None:
            return False
        elem = self.elem_type(node.input[0]) if node.input else 0
        like = self.shape_source(node)
        if like is not None and self.rank(like) is not None:
            dims = self.shape(like) or []
        elif node.op_type in ("Reshape", "Expand") and isinstance((self.shape(node.input[1]) or [None])[0], int):
            # The length of the target shape is the rank; Expand's result has at least the data's.
            length = (self.shape(node.input[1]) or [0])[0]
            assert isinstance(length, int)
            own = self.rank(node.input[0]) if node.op_type == "Expand" else 0
            if own is None:
                return False
            dims = [None] * max(length, own)
        else:
            return False
        stated = helper.make_tensor_value_info(name, elem, dims)
        outputs = [value for value in self.model.graph.output if value.name == name]
        value = outputs[0] if outputs else self.model.graph.value_info.add()
        value.CopyFrom(stated)
        self._types[name] = value.type.tensor_type
        return True

    def _round_down(self, pool: onnx.NodeProto) -> None:
        """Write a pool in ceil_mode in floor mode where ONNX's inference gets its size wrong."""
        given = attributes(pool)
        sizes = [size for size in (self.shape(pool.input[0]) or [])[2:] if isinstance(size, int)]
        pads = floor_mode_pads(given, sizes) if len(sizes) == len(given["kernel_shape"]) else None
        if pads is None:
            return
        kept = {key: value for key, value in given.items() if key not in ("auto_pad", "ceil_mode")}
        del pool.attribute[:]
        pool.attribute.extend(helper.make_attribute(key, value) for key, value in (kept | {"pads": pads}).items())
        del self.model.graph.value_info[:]
        for output in self.model.graph.output:
            output.type.tensor_type.ClearField("shape")
        self._types.clear()
        self.infer_shapes()
        for output in self.model.graph.output:
            if output.name in self._types:
                output.type.tensor_type.CopyFrom(self._types[output.name])

    def shape_source(self, node: onnx.NodeProto) -> str | None:
        """A value whose shape the node's output has, where ONNX's inference would not tell."""
        if node.op_type == "GroupNormalization":
            return str(node.input[0])
        if node.op_type == "Reshape":
            target = self._producers.get(node.input[1])
            if target is not None and target.op_type == "Shape" and not target.attribute:
                return str(target.input[0])
        return None

    def constant(self, name: str) -> Array | None:
        """The value of a constant, or None if `name` is computed."""
        if name not in self._constants:
            return None
        if name not in self._arrays:
            self._arrays[name] = numpy_helper.to_array(self._constants[name])
        return self._arrays[name]

    def is_constant(self, name: str) -> bool:
        return name in self._constants

    def shape(self, name: str) -> list[Dim] | None:
        """Sizes: an int where static, a name where symbolic, None where unknown; None for an unknown rank."""
        if name in self._constants:
            return list(self._constants[name].dims)
        kind = self._types.get(name)
        if kind is None or not kind.HasField("shape"):
            return None
        return [
            d.dim_value if d.HasField("dim_value") else (d.dim_param or None if d.HasField("dim_param") else None)
            for d in kind.shape.dim
        ]

    def rank(self, name: str) -> int | None:
        shape = self.shape(name)
        return None if shape is None else len(shape)

    def elem_type(self, name: str) -> int:
        """onnx.TensorProto.DataType of a value; FLOAT where inference does not tell."""
        if name in self._constants:
            return int(self._constants[name].data_type)
        kind = self._types.get(name)
        return int(kind.elem_type) if kind is not None and kind.elem_type else int(onnx.TensorProto.FLOAT)

    def dtype(self, name: str) -> np.dtype[Any]:
        return np.dtype(helper.tensor_dtype_to_np_dtype(self.elem_type(name)))

    # -- writing ---------------------------------------------------------------------------------------------

    def unique(self, wanted: str) -> str:
        """`wanted`, or `wanted` with a number behind it if the graph uses the name already."""
        name, count = wanted, 1
        while name in self._names:
            count += 1
            name = f"{wanted}_{count}"
        self._names.add(name)
        return name

    def op(self, op_type: str, *inputs: str, name: str, outputs: int | Sequence[str] = 1, **attributes: Any) -> str:
        """Append a node; its (first) output has the node's name unless `outputs` names them.

        Returns the name of the first output.
        """
        name = self.unique(name)
        if isinstance(outputs, int):
            outs = [name, *(self.unique(f"{name}/{i}") for i in range(1, outputs))]
        else:
            outs = list(outputs)
            self._names.update(outs)
        given = {key: value for key, value in attributes.items() if value is not None}
        self.model.graph.node.append(helper.make_node(op_type, list(inputs), outs, name=name, **given))
        return outs[0]

    def const(self, value: npt.ArrayLike, name: str, dtype: npt.DTypeLike | None = None) -> str:
        """Append an initializer and return its name."""
        name = self.unique(name)
        array = np.ascontiguousarray(np.asarray(value, dtype)).reshape(np.shape(value))
        tensor = numpy_helper.from_array(array, name)
        self.model.graph.initializer.append(tensor)
        self._constants[name] = tensor
        self._arrays[name] = array
        return name

    def int64s(self, values: Iterable[int], name: str) -> str:
        return self.const(np.array(list(values), np.int64), name)


def reduce_mean(graph: Graph, x: str, axis: int, name: str, keepdims: int, output: str | None = None) -> str:
    """Append ReduceMean over one axis, in the form of the graph's opset (axes are an input from 18 on)."""
    outputs: int | list[str] = 1 if output is None else [output]
    if graph.opset >= 18:
        axes = graph.int64s([axis], f"{name}_axes")
        return graph.op("ReduceMean", x, axes, name=name, outputs=outputs, keepdims=keepdims)
    return graph.op("ReduceMean", x, name=name, outputs=outputs, axes=[axis], keepdims=keepdims)


def attributes(node: onnx.NodeProto) -> dict[str, Any]:
    """A node's attributes as Python values; text as str."""
    values = {a.name: helper.get_attribute_value(a) for a in node.attribute}
    return {k: v.decode(errors="replace") if isinstance(v, bytes) else v for k, v in values.items()}


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


def _constant_of(node: onnx.NodeProto) -> onnx.TensorProto | None:
    """The tensor of a Constant node, None if it is sparse or text."""
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
