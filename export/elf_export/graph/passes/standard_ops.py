"""Write the ops that ONNX Runtime fuses and quantises in standard ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper, numpy_helper

from elf_export.graph.graph import Array, attributes, defined_in, nested_graphs

MICROSOFT = "com.microsoft"


def standard_ops(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of `model` in which ops of OPS, fused or quantised, are chains of standard ones of the same values.

    A quantised op is what QuantizeLinear makes of the float op behind DequantizeLinear; its constant operands are
    written as floats at once.  Only nodes of the main graph are looked at.
    """
    if not any((node.domain, node.op_type) in OPS for node in model.graph.node):
        return model
    result = onnx.ModelProto()
    result.CopyFrom(model)
    writer = _Writer(result)
    nodes = list(result.graph.node)
    for node in nodes:
        write = OPS.get((node.domain, node.op_type))
        if write is None:
            writer.nodes.append(node)
        else:
            writer.begin(node)
            write(writer, node)
    copies = [onnx.NodeProto() for _ in writer.nodes]
    for copy, node in zip(copies, writer.nodes, strict=True):
        copy.CopyFrom(node)
    del result.graph.node[:]
    result.graph.node.extend(copies)
    return result


class _Writer:
    """Appends the nodes that stand for one; the last has its outputs, and all are called by its name."""

    def __init__(self, model: onnx.ModelProto) -> None:
        self.model = model
        self.nodes: list[onnx.NodeProto] = []
        self.constants = {tensor.name: tensor for tensor in model.graph.initializer}
        for node in model.graph.node:
            if node.op_type == "Constant" and node.attribute and node.attribute[0].name == "value":
                self.constants[node.output[0]] = node.attribute[0].t
        self.taken = {name for graph in nested_graphs(model.graph) for name in defined_in(graph)}
        self.prefix, self.result = "", ""

    def begin(self, node: onnx.NodeProto) -> None:
        self.prefix, self.result = node.name or node.output[0], node.output[0]

    def name(self, role: str) -> str:
        wanted, count = f"{self.prefix}/{role}", 1
        while wanted in self.taken:
            count += 1
            wanted = f"{self.prefix}/{role}_{count}"
        self.taken.add(wanted)
        return wanted

    def op(self, op_type: str, *inputs: str, role: str = "", **given: Any) -> str:
        """A node; without a role it makes the result."""
        output = self.name(role) if role else self.result
        name = output if role else self.prefix
        while inputs and not inputs[-1]:
            inputs = inputs[:-1]
        kept = {key: value for key, value in given.items() if value is not None}
        self.nodes.append(helper.make_node(op_type, list(inputs), [output], name=name, **kept))
        return output

    def const(self, value: npt.ArrayLike, role: str) -> str:
        name = self.name(role)
        tensor = numpy_helper.from_array(np.asarray(value, np.float32), name)
        self.model.graph.initializer.append(tensor)
        self.constants[name] = tensor
        return name

    def value(self, name: str) -> Array | None:
        return numpy_helper.to_array(self.constants[name]) if name in self.constants else None

    def real(self, q: str, scale: str, zero: str, role: str, axis: int | None = None) -> str:
        """The float numbers that the integers `q` stand for."""
        values = self.value(q), self.value(scale), self.value(zero) if zero else np.zeros(1)
        if values[0] is None or values[1] is None or values[2] is None:
            return self.op("DequantizeLinear", q, scale, zero, role=role)
        return self.const(_reals(values[0], values[1], values[2], axis), role)

    def operand(self, node: onnx.NodeProto, index: int, role: str, axis: int | None = None) -> str:
        """As `real`, of the node's inputs from `index` on: integers, scale, zero."""
        return self.real(node.input[index], node.input[index + 1], _input(node, index + 2), role, axis)

    def quantized(self, x: str, scale: str, zero: str) -> None:
        self.op("QuantizeLinear", x, scale, zero)


def _reals(q: Array, scale: Array, zero: Array, axis: int | None) -> Array:
    """(q - zero) scale in float32, scale and zero along `axis` where there are several."""
    shape = [1] * q.ndim
    if axis is not None and q.ndim:
        shape[axis] = -1
    wide = [v.astype(np.float64).reshape(shape if v.size > 1 else ()) for v in (scale, zero)]
    return np.asarray((q.astype(np.float64) - wide[1]) * wide[0], np.float32).reshape(q.shape)


def _product(a: Array, b: Array) -> Array:
    """The scales of a bias, from those of the two factors."""
    return np.asarray(a.astype(np.float64) * b.astype(np.float64)).reshape(-1)


def _input(node: onnx.NodeProto, index: int) -> str:
    return str(node.input[index]) if index < len(node.input) else ""


def _fused_conv(w: _Writer, node: onnx.NodeProto) -> None:
    """act(W * x + b + z)."""
    attrs = attributes(node)
    activation, params = attrs.pop("activation", ""), attrs.pop("activation_params", [])
    added = _input(node, 3)
    y = w.op("Conv", *node.input[:3], role="conv" if activation or added else "", **attrs)
    if added:
        y = w.op("Add", y, added, role="sum" if activation else "")
    if activation:
        _activation(w, y, activation, params)


def _activation(w: _Writer, y: str, kind: str, params: list[float]) -> None:
    if kind == "Clip":
        low, high = (w.const(v, role) for v, role in zip(params, ("low", "high"), strict=True))
        w.op("Clip", y, low, high)
    else:
        given: dict[str, Any] = dict(zip(("alpha", "beta"), params, strict=False))
        w.op(kind, y, **given)


def _fused_gemm(w: _Writer, node: onnx.NodeProto) -> None:
    """act(alpha A B + beta C)."""
    attrs = attributes(node)
    activation = attrs.pop("activation", "")
    params = [attrs.pop(key) for key in ("activation_alpha", "activation_beta") if key in attrs]
    attrs.pop("activation_gamma", None)
    y = w.op("Gemm", *node.input, role="gemm" if activation else "", **attrs)
    if activation:
        _activation(w, y, activation, params)


def _gelu(w: _Writer, node: onnx.NodeProto) -> None:
    """x (1 + erf(x / sqrt 2)) / 2, of the sum of both inputs where there are two."""
    x = w.op("Add", *node.input, role="sum") if _input(node, 1) else node.input[0]
    scaled = w.op("Mul", x, w.const(math.sqrt(0.5), "root"), role="scaled")
    curve = w.op("Add", w.op("Erf", scaled, role="erf"), w.const(1, "one"), role="curve")
    w.op("Mul", w.op("Mul", x, w.const(0.5, "half"), role="halved"), curve)


def _quick_gelu(w: _Writer, node: onnx.NodeProto) -> None:
    """x sigmoid(alpha x)."""
    alpha = w.const(attributes(node).get("alpha", 1.702), "alpha")
    w.op("Mul", node.input[0], w.op("Sigmoid", w.op("Mul", node.input[0], alpha, role="scaled"), role="gate"))


def _qlinear_conv(w: _Writer, node: onnx.NodeProto) -> None:
    """Inputs x, its scale and zero, w, its scales and zeros, y's scale and zero, b of scale x_scale w_scale."""
    x_scale, w_scale, bias = w.value(node.input[1]), w.value(node.input[4]), _input(node, 8)
    inputs = [w.operand(node, 0, "x"), w.operand(node, 3, "w", 0)]
    if bias:
        b = w.value(bias)
        if b is None or x_scale is None or w_scale is None:
            scale = w.op("Mul", node.input[1], node.input[4], role="b_scale")
            inputs.append(w.op("DequantizeLinear", bias, scale, role="b", axis=0))
        else:
            inputs.append(w.const(_reals(b, _product(x_scale, w_scale), np.zeros(1), 0), "b"))
    w.quantized(w.op("Conv", *inputs, role="conv", **attributes(node)), *node.input[6:8])


def _of_two(op_type: str) -> Callable[[_Writer, onnx.NodeProto], None]:
    """Of inputs a, scale, zero, b, scale, zero, y's scale and zero."""

    def write(w: _Writer, node: onnx.NodeProto) -> None:
        axis = None if op_type != "MatMul" else -1
        a, b = w.operand(node, 0, "a"), w.operand(node, 3, "b", axis)
        w.quantized(w.op(op_type, a, b, role="real"), node.input[6], _input(node, 7))

    return write


def _of_one(op_type: str) -> Callable[[_Writer, onnx.NodeProto], None]:
    """Of inputs x, scale, zero, y's scale and zero."""

    def write(w: _Writer, node: onnx.NodeProto) -> None:
        attrs = attributes(node)
        attrs.pop("opset", None)
        turned = attrs.pop("channels_last", 0)
        x = w.operand(node, 0, "x")
        if turned:
            x = w.op("Transpose", x, role="channels_first", perm=[0, 3, 1, 2])
        y = w.op(op_type, x, role="real", **attrs)
        if turned:
            y = w.op("Transpose", y, role="channels_last", perm=[0, 2, 3, 1])
        w.quantized(y, node.input[3], _input(node, 4))

    return write


def _qlinear_concat(w: _Writer, node: onnx.NodeProto) -> None:
    """Of inputs y's scale and zero, then x, scale, zero of each."""
    parts = [w.operand(node, i, f"x{i // 3}") for i in range(2, len(node.input), 3)]
    w.quantized(w.op("Concat", *parts, role="real", **attributes(node)), *node.input[:2])


def _qgemm(w: _Writer, node: onnx.NodeProto) -> None:
    """Of inputs a, scale, zero, b, scales, zeros, c of scale a_scale b_scale, y's scale and zero."""
    attrs = attributes(node)
    inputs = [w.operand(node, 0, "a"), w.operand(node, 3, "b", 0 if attrs.get("transB") else 1)]
    if _input(node, 6):
        c, one, other = (w.value(node.input[i]) for i in (6, 1, 4))
        if c is None or one is None or other is None:
            scale = w.op("Mul", node.input[1], node.input[4], role="c_scale")
            inputs.append(w.op("DequantizeLinear", node.input[6], scale, role="c"))
        else:
            inputs.append(w.const(_reals(c, _product(one, other), np.zeros(1), c.ndim - 1), "c"))
    if not _input(node, 7):
        w.op("Gemm", *inputs, **attrs)
    else:
        w.quantized(w.op("Gemm", *inputs, role="real", **attrs), node.input[7], _input(node, 8))


OPS: dict[tuple[str, str], Callable[[_Writer, onnx.NodeProto], None]] = {
    (MICROSOFT, "FusedConv"): _fused_conv,
    (MICROSOFT, "FusedGemm"): _fused_gemm,
    (MICROSOFT, "Gelu"): _gelu,
    (MICROSOFT, "BiasGelu"): _gelu,
    (MICROSOFT, "QuickGelu"): _quick_gelu,
    ("", "QLinearConv"): _qlinear_conv,
    ("", "QLinearMatMul"): _of_two("MatMul"),
    (MICROSOFT, "QLinearAdd"): _of_two("Add"),
    (MICROSOFT, "QLinearMul"): _of_two("Mul"),
    (MICROSOFT, "QLinearSigmoid"): _of_one("Sigmoid"),
    (MICROSOFT, "QLinearLeakyRelu"): _of_one("LeakyRelu"),
    (MICROSOFT, "QLinearSoftmax"): _of_one("Softmax"),
    (MICROSOFT, "QLinearAveragePool"): _of_one("AveragePool"),
    (MICROSOFT, "QLinearGlobalAveragePool"): _of_one("GlobalAveragePool"),
    (MICROSOFT, "QLinearConcat"): _qlinear_concat,
    (MICROSOFT, "QGemm"): _qgemm,
}
