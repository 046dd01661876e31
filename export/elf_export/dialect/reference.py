"""The operations in numpy, by plain loops over windows, and as operators of ONNX's reference evaluator.

Written from the equations of `ops`, for use as an oracle: nothing here is shared with a lowering.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from onnx.reference.op_run import OpRun

from elf_export.graph.nodes import OWN

Array = npt.NDArray[Any]
Places = tuple[int, ...]


def step(v: Array) -> Array:
    return (v > 0).astype(v.dtype)


def between(low: Array | None, high: Array | None, y: Array) -> Array:
    return ((y > (-np.inf if low is None else low)) & (y < (np.inf if high is None else high))).astype(y.dtype)


def max_pool_grad(dy: Array, y: Array, x: Array, **window: Any) -> Array:
    dx = np.zeros_like(x)
    for image, channel in np.ndindex(x.shape[:2]):
        for m, places in _windows(x.shape[2:], dy.shape[2:], **window):
            inside = [i for _, i in places if x[(image, channel, *i)] == y[(image, channel, *m)]]
            dx[(image, channel, *inside[0])] += dy[(image, channel, *m)]
    return dx


def window_sum(dy: Array, scale: Array | None, x: Array, **window: Any) -> Array:
    dx, scale = np.zeros_like(x), np.ones((), x.dtype) if scale is None else scale
    for m, places in _windows(x.shape[2:], dy.shape[2:], **window):
        for _, i in places:
            dx[_at(i)] += scale * dy[_at(m)]
    return dx


def conv_grad(dy: Array, weight: Array, x: Array, group: int = 1, **window: Any) -> Array:
    dx = np.zeros_like(x)
    of_group = weight.reshape(group, -1, *weight.shape[1:])  # (g, O/g, I/g, k...)
    for m, places in _windows(x.shape[2:], dy.shape[2:], weight.shape[2:], **window):
        value = dy[_at(m)].reshape(len(dy), group, -1)
        for t, i in places:
            pulled = np.einsum("goi,ngo->ngi", of_group[_at(t)], value)
            dx[_at(i)] += pulled.reshape(len(dy), -1)
    return dx


def _at(place: Places) -> Any:
    """The index of a place in every image and channel."""
    return (..., *place)


def _windows(
    size: Sequence[int], count: Sequence[int], kernel: Sequence[int] = (), **given: Any
) -> Iterator[tuple[Places, list[tuple[Places, Places]]]]:
    """Each window m, and its offsets t and places i that lie in the image, in raster order."""
    kernel, n = given.get("kernel_shape") or kernel, len(size)
    strides, dilations = (given.get(name) or [1] * n for name in ("strides", "dilations"))
    begin = _padding(size, kernel, strides, dilations, given)
    for m in np.ndindex(*count):
        found = []
        for t in np.ndindex(*kernel):
            i = tuple(s * a + d * b - p for s, a, d, b, p in zip(strides, m, dilations, t, begin, strict=True))
            if all(0 <= at < end for at, end in zip(i, size, strict=True)):
                found.append((t, i))
        yield m, found


def _padding(
    size: Sequence[int], kernel: Sequence[int], strides: Sequence[int], dilations: Sequence[int], given: dict[str, Any]
) -> list[int]:
    """The padding in front of each axis."""
    auto = given.get("auto_pad") or "NOTSET"
    if not auto.startswith("SAME"):
        return list((given.get("pads") or [0] * len(size))[: len(size)]) if auto == "NOTSET" else [0] * len(size)
    reach = zip(size, kernel, strides, dilations, strict=True)
    totals = [max((math.ceil(h / s) - 1) * s + (k - 1) * d + 1 - h, 0) for h, k, s, d in reach]
    return [total // 2 if auto == "SAME_UPPER" else total - total // 2 for total in totals]


_FUNCTIONS: dict[str, Callable[..., Array]] = {
    "Step": step, "Between": between, "Complement": lambda mask: 1 - mask,
    "MaxPoolGrad": max_pool_grad, "WindowSum": window_sum, "ConvGrad": conv_grad,
}  # fmt: skip


def _operator(name: str) -> type[OpRun]:
    class Operator(OpRun):
        op_domain = OWN

        def _run(self, *inputs: Array, **_defaults: Any) -> tuple[Array]:
            given = {a.name: getattr(self, a.name) for a in self.onnx_node.attribute}
            return (_FUNCTIONS[name](*inputs, **given),)

    Operator.__name__ = name
    return Operator


OPERATORS = [_operator(name) for name in _FUNCTIONS]
"""For ``onnx.reference.ReferenceEvaluator(model, new_ops=OPERATORS)``."""
