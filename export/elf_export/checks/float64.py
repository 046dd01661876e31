"""A graph run in float64, by ONNX's reference evaluator: slow, and free of float32's rounding."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, numpy_helper
from onnx.reference import ReferenceEvaluator
from onnx.reference.op_run import OpRun

from elf_export.graph.passes import opset_of

Array = npt.NDArray[Any]
Array64 = npt.NDArray[np.float64]


def float64_forward(model: onnx.ModelProto, image: str, output: str) -> Callable[[Array64], Array64]:
    """``f(x)``: the value `output` of a float32 model, computed in float64."""
    evaluator = ReferenceEvaluator(in_double(model), new_ops=STAND_INS)
    if opset_of(model) < 13:
        evaluator = ReferenceEvaluator(in_double(model), new_ops=STAND_INS + SOFTMAX_BEFORE_13)

    def forward(x: Array64) -> Array64:
        values: Any = evaluator.run([output], {image: x.astype(np.float64)})
        return np.asarray(values[0], np.float64)

    return forward


def in_double(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of a float32 model whose floats are float64; the same numbers, as every float32 is a float64."""
    result = onnx.ModelProto()
    result.CopyFrom(model)
    graph = result.graph
    for tensor in graph.initializer:
        _widen(tensor)
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.type == onnx.AttributeProto.TENSOR:
                _widen(attribute.t)
            elif attribute.name == "to" and attribute.i == TensorProto.FLOAT:
                attribute.i = TensorProto.DOUBLE
    for value in (*graph.input, *graph.output):
        if value.type.tensor_type.elem_type == TensorProto.FLOAT:
            value.type.tensor_type.elem_type = TensorProto.DOUBLE
    del graph.value_info[:]
    return result


def _widen(tensor: TensorProto) -> None:
    if tensor.data_type == TensorProto.FLOAT:
        values = numpy_helper.to_array(tensor).astype(np.float64)
        tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))


class Conv(OpRun):
    """The evaluator's loops over groups and places in Python: a depthwise layer takes it seconds."""

    op_domain = ""

    def _run(
        self, x: Array, w: Array, b: Array | None = None, kernel_shape: Sequence[int] | None = None,
        group: int = 1, **window: Any,
    ) -> tuple[Array]:  # fmt: skip
        del kernel_shape  # the kernel has it
        n = x.ndim - 2
        windows = _windows(x, w.shape[2:], 0.0, **window)
        out = windows.shape[2 : 2 + n]
        # (N, G, I/g k..., places) from (N, G, I/g, places, k...)
        apart = windows.reshape(len(x), group, w.shape[1], *out, *w.shape[2:])
        order = (0, 1, 2, *range(3 + n, 3 + 2 * n), *range(3, 3 + n))
        columns = apart.transpose(order).reshape(len(x), group, -1, int(np.prod(out)))
        y = (w.reshape(group, len(w) // group, -1) @ columns).reshape(len(x), len(w), *out)
        return (y if b is None else y + b.reshape(-1, *[1] * n),)


class MaxPool(OpRun):
    """The evaluator's loops over places in Python."""

    op_domain = ""

    def _run(self, x: Array, kernel_shape: Sequence[int] = (), storage_order: int = 0, **window: Any) -> tuple[Array]:
        del storage_order  # of the indices, which no graph with an adjoint asks for
        if len(self.onnx_node.output) > 1:
            raise NotImplementedError("MaxPool's indices")
        return (_windows(x, kernel_shape, -np.inf, **window).max(axis=tuple(range(x.ndim, 2 * x.ndim - 2))),)


def _windows(
    x: Array, kernel: Sequence[int], fill: float, auto_pad: str | None = None,
    dilations: Sequence[int] | None = None, pads: Sequence[int] | None = None,
    strides: Sequence[int] | None = None, ceil_mode: int = 0,
) -> Array:  # fmt: skip
    """What a sliding window sees at each place: (N, C, H, W) -> (N, C, places..., kernel...)."""
    n = len(kernel)
    steps, gaps, sizes = strides or [1] * n, dilations or [1] * n, x.shape[2:]
    extent = [(k - 1) * d + 1 for k, d in zip(kernel, gaps, strict=True)]
    begin, end = list((pads or [0] * 2 * n)[:n]), list((pads or [0] * 2 * n)[n:])
    if auto_pad in ("SAME_UPPER", "SAME_LOWER"):
        lack = [max((-(-h // s) - 1) * s + e - h, 0) for h, s, e in zip(sizes, steps, extent, strict=True)]
        small, large = [t // 2 for t in lack], [t - t // 2 for t in lack]
        begin, end = (small, large) if auto_pad == "SAME_UPPER" else (large, small)
    elif auto_pad == "VALID":
        begin = end = [0] * n
    if ceil_mode:
        # Room for one more window, unless it would begin behind the last pixel.
        for i, (h, s, e) in enumerate(zip(sizes, steps, extent, strict=True)):
            last = -(-(h + begin[i] + end[i] - e) // s) * s
            last -= s if last >= h + begin[i] else 0
            end[i] = max(end[i], last + e - h - begin[i])
    padded = np.pad(x, [(0, 0), (0, 0), *zip(begin, end, strict=True)], constant_values=fill)
    windows = np.lib.stride_tricks.sliding_window_view(padded, extent, tuple(range(2, 2 + n)))
    places = tuple(slice(None, None, s) for s in steps)
    return windows[(slice(None), slice(None), *places, *(slice(None, None, d) for d in gaps))]


class BatchNormalization(OpRun):
    """The evaluator's takes the batch's own mean in the opsets below 14, whenever the node has a momentum."""

    op_domain = ""

    def _run(
        self, x: Array, scale: Array, bias: Array, mean: Array, var: Array, epsilon: float = 1e-5, **_: Any
    ) -> tuple[Array]:
        shape = [-1, *[1] * (x.ndim - 2)]
        factor = scale / np.sqrt(var + float(epsilon))
        return ((x - mean.reshape(shape)) * factor.reshape(shape) + bias.reshape(shape),)


class Erf(OpRun):
    """The evaluator's gives float32."""

    op_domain = ""

    def _run(self, x: Array) -> tuple[Array]:
        return (np.vectorize(math.erf, otypes=[np.float64])(x),)


class Gelu(OpRun):
    """The evaluator's gives float32."""

    op_domain = ""

    def _run(self, x: Array, approximate: str = "none") -> tuple[Array]:
        if approximate == "tanh":
            curve = np.tanh(math.sqrt(2 / math.pi) * (x + 0.044715 * x**3))
        else:
            curve = np.vectorize(math.erf, otypes=[np.float64])(x * math.sqrt(0.5))
        return (0.5 * x * (1 + curve),)


class GroupNormalization(OpRun):
    """The evaluator's gives float32, and has scale and bias for each group in opsets before 21."""

    op_domain = ""

    def _run(
        self, x: Array, scale: Array, bias: Array, num_groups: int = 1, epsilon: float = 1e-5, **_: Any
    ) -> tuple[Array]:
        grouped = x.reshape(len(x), num_groups, -1)
        centred = grouped - grouped.mean(-1, keepdims=True)
        normal = centred / np.sqrt((centred**2).mean(-1, keepdims=True) + float(epsilon))
        each = [-1, *[1] * (x.ndim - 2)]
        if len(scale) == x.shape[1]:
            return (normal.reshape(x.shape) * scale.reshape(each) + bias.reshape(each),)
        return ((normal * scale[:, None] + bias[:, None]).reshape(x.shape),)


class LRN(OpRun):
    """The evaluator's gives float32."""

    op_domain = ""

    def _run(self, x: Array, alpha: float = 1e-4, beta: float = 0.75, bias: float = 1.0, size: int = 1) -> tuple[Array]:
        before, behind = (size - 1) // 2, math.ceil((size - 1) / 2)
        squares = np.pad(x * x, [(0, 0), (before, behind), *[(0, 0)] * (x.ndim - 2)])
        total = sum(squares[:, i : i + x.shape[1]] for i in range(size))
        return (x / (float(bias) + float(alpha) / size * total) ** float(beta),)


class _Flattening(OpRun):
    """The evaluator's takes one axis in every opset; before 13 the op went over all axes from `axis` on."""

    op_domain = ""
    logarithm = False

    def _run(self, x: Array, axis: int = 1) -> tuple[Array]:
        axes = tuple(range(axis % x.ndim, x.ndim))
        shifted = x - x.max(axes, keepdims=True)
        total = np.exp(shifted).sum(axes, keepdims=True)
        return (shifted - np.log(total) if self.logarithm else np.exp(shifted) / total,)


class Softmax(_Flattening):
    """Of opset 12 and before."""


class LogSoftmax(_Flattening):
    """Of opset 12 and before."""

    logarithm = True


SOFTMAX_BEFORE_13: list[type[OpRun]] = [Softmax, LogSoftmax]
STAND_INS = [Conv, MaxPool, BatchNormalization, Erf, Gelu, GroupNormalization, LRN]
