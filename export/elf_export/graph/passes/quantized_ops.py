"""Ops of 8-bit integers: what QuantizeLinear makes of the float op behind DequantizeLinear."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from elf_export.graph.graph import Array, attributes

from .writer import MICROSOFT, Writer


def _operand(w: Writer, index: int, role: str, axis: int | None = None) -> str:
    """The float numbers that integers stand for: inputs from `index` on are the integers, their scale, their zero.

    Constants are written as floats at once.
    """
    q, scale, zero = (w.input(index + i) for i in range(3))
    values = w.value(q), w.value(scale), w.value(zero) if zero else np.zeros(1)
    if values[0] is None or values[1] is None or values[2] is None:
        return w.op("DequantizeLinear", q, scale, zero, role=role)
    return w.const(_reals(values[0], values[1], values[2], axis), role)


def _quantized(w: Writer, x: str, scale: str, zero: str) -> None:
    w.op("QuantizeLinear", x, scale, zero)


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


def _qlinear_conv(w: Writer) -> None:
    """Inputs x, its scale and zero, w, its scales and zeros, y's scale and zero, b of scale x_scale w_scale."""
    x_scale, w_scale, bias = w.value(w.node.input[1]), w.value(w.node.input[4]), w.input(8)
    inputs = [_operand(w, 0, "x"), _operand(w, 3, "w", 0)]
    if bias:
        b = w.value(bias)
        if b is None or x_scale is None or w_scale is None:
            scale = w.op("Mul", w.node.input[1], w.node.input[4], role="b_scale")
            inputs.append(w.op("DequantizeLinear", bias, scale, role="b", axis=0))
        else:
            inputs.append(w.const(_reals(b, _product(x_scale, w_scale), np.zeros(1), 0), "b"))
    _quantized(w, w.op("Conv", *inputs, role="conv", **attributes(w.node)), *w.node.input[6:8])


def _of_two(op_type: str) -> Callable[[Writer], None]:
    """Of inputs a, scale, zero, b, scale, zero, y's scale and zero."""

    def write(w: Writer) -> None:
        axis = None if op_type != "MatMul" else -1
        a, b = _operand(w, 0, "a"), _operand(w, 3, "b", axis)
        _quantized(w, w.op(op_type, a, b, role="real"), w.node.input[6], w.input(7))

    return write


def _of_one(op_type: str) -> Callable[[Writer], None]:
    """Of inputs x, scale, zero, y's scale and zero."""

    def write(w: Writer) -> None:
        attrs = attributes(w.node)
        attrs.pop("opset", None)
        turned = attrs.pop("channels_last", 0)
        x = _operand(w, 0, "x")
        if turned:
            x = w.op("Transpose", x, role="channels_first", perm=[0, 3, 1, 2])
        y = w.op(op_type, x, role="real", **attrs)
        if turned:
            y = w.op("Transpose", y, role="channels_last", perm=[0, 2, 3, 1])
        _quantized(w, y, w.node.input[3], w.input(4))

    return write


def _qlinear_concat(w: Writer) -> None:
    """Of inputs y's scale and zero, then x, scale, zero of each."""
    parts = [_operand(w, i, f"x{i // 3}") for i in range(2, len(w.node.input), 3)]
    _quantized(w, w.op("Concat", *parts, role="real", **attributes(w.node)), *w.node.input[:2])


def _qgemm(w: Writer) -> None:
    """Of inputs a, scale, zero, b, scales, zeros, c of scale a_scale b_scale, y's scale and zero."""
    attrs = attributes(w.node)
    inputs = [_operand(w, 0, "a"), _operand(w, 3, "b", 0 if attrs.get("transB") else 1)]
    if w.input(6):
        c, one, other = (w.value(w.node.input[i]) for i in (6, 1, 4))
        if c is None or one is None or other is None:
            scale = w.op("Mul", w.node.input[1], w.node.input[4], role="c_scale")
            inputs.append(w.op("DequantizeLinear", w.node.input[6], scale, role="c"))
        else:
            inputs.append(w.const(_reals(c, _product(one, other), np.zeros(1), c.ndim - 1), "c"))
    if not w.input(7):
        w.op("Gemm", *inputs, **attrs)
    else:
        _quantized(w, w.op("Gemm", *inputs, role="real", **attrs), w.node.input[7], w.input(8))


QUANTIZED: dict[tuple[str, str], Callable[[Writer], None]] = {
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
