"""8-bit convolutions: their weights, and channels in numbers that ONNX Runtime's kernels are fast for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import onnx

from elf_export.graph.graph import Array, attributes

from .quantizer import Quantizer
from .scheme import weights

FINE = 16.0  # how much finer small gradients are kept than large ones
# What ONNX Runtime's 8-bit convolutions on x86 are fast for: channels of the input, and of the result, in such numbers.
DEPTH, BREADTH = 4, 16
# How much finer the rest is kept that rounding leaves of an image.  Its weights are that much smaller: more would leave
# them too few of the 63 levels.
REST = 8.0


def convolve(
    quantizer: Quantizer, node: onnx.NodeProto, x: str, kernel: Array, bias: Array | None, output: str
) -> None:
    """The Conv with the rounded input, int8 weights and an int32 bias."""
    graph, given = quantizer.graph, attributes(node)
    dense = given.get("group", 1) == 1
    if dense and x in quantizer.inside and kernel.shape[1] <= DEPTH and quantizer.rounding[x].zero:
        x, kernel = _with_rest(quantizer, x), np.concatenate([kernel, kernel / REST], axis=1)
    q, scales = weights(kernel)
    source = quantizer.twins[x]
    lack = -kernel.shape[1] % DEPTH
    if lack and dense:
        q = np.pad(q, [(0, 0), (0, lack), (0, 0), (0, 0)])
        source = _deepened(quantizer, x, kernel.shape[1], lack)
    inputs = [source, _constant(quantizer, q, scales, f"{output}/weight")]
    if bias is not None:
        steps = scales * np.float32(quantizer.rounding[x].scale)
        whole = np.clip(np.rint(bias / steps.astype(np.float64)), -(2**31) + 1, 2**31 - 1)
        inputs.append(_constant(quantizer, whole.astype(np.int32), steps, f"{output}/bias"))
    graph.op("Conv", *inputs, name=node.name or output, outputs=[output], **given)


def _with_rest(quantizer: Quantizer, x: str) -> str:
    """x rounded, and behind it along the channels `REST` times what that leaves of x.

    For a convolution of an image: on a soft one neighbours differ by less than a step.
    """
    graph, scheme, both = quantizer.graph, quantizer.rounding[x], f"{x}/with_rest"
    if both not in quantizer.integers:
        rest = graph.op("Sub", x, quantizer.twins[x], name=f"{x}/rest")
        finer = quantizer.scale(f"{x}/rest", replace(scheme, scale=scheme.scale / REST))
        q = graph.op("QuantizeLinear", rest, *finer, name=f"{x}/rest_q")
        joined = graph.op("Concat", quantizer.integers[x], q, name=f"{x}/with_rest_q", axis=1)
        quantizer.dequantize(both, joined, scheme)
    return both


def _deepened(quantizer: Quantizer, x: str, depth: int, lack: int) -> str:
    """x with so many more channels, for weights of zero: its first ones again, whose planes are quickly copied."""
    graph, scheme = quantizer.graph, quantizer.rounding[x]
    channels = graph.int64s(np.arange(depth + lack) % depth, f"{x}/deep_channels")
    q = graph.op("Gather", quantizer.integers[x], channels, name=f"{x}/deep_q", axis=1)
    return graph.op("DequantizeLinear", q, *quantizer.scale(f"{x}/deep", scheme), name=f"{x}/deep")


def _constant(quantizer: Quantizer, q: Array, scales: Array, name: str) -> str:
    """Weights or biases, one scale for each output channel."""
    graph = quantizer.graph
    zeros = graph.const(np.zeros(len(scales), q.dtype), f"{name}_zero")
    constants = graph.const(q, f"{name}_q"), graph.const(scales, f"{name}_scale"), zeros
    return graph.op("DequantizeLinear", *constants, name=name, axis=0)


def two_steps_of(kernel: Array, breadth: int) -> Array:
    """The kernels of W x and F W x, and idle ones up to a multiple of `breadth`."""
    idle = np.zeros((-2 * len(kernel) % breadth, *kernel.shape[1:]))
    return np.concatenate([kernel, kernel * FINE, idle])


def magnitude_of_two(quantizer: Quantizer, y: str, both: str, count: int) -> None:
    """|W x| in steps that are finer where it is small: |F W x| / F up to where that saturates."""
    graph, scheme = quantizer.graph, quantizer.schemes[y]
    axis, halves = graph.int64s([1], f"{y}/axis"), []
    for start, name in ((0, "coarse"), (count, "fine")):
        bounds = [graph.int64s([v], f"{y}/{name}_{what}") for v, what in ((start, "from"), (start + count, "to"))]
        q = graph.op("Slice", quantizer.integers[both], *bounds, axis, name=f"{y}/{name}_q")
        value = graph.op("DequantizeLinear", q, *quantizer.scale(f"{y}/{name}", scheme), name=f"{y}/{name}")
        halves.append(graph.op("Abs", value, name=f"{y}/{name}_magnitude"))
    # -128 and 127 both saturate.
    top = graph.const(np.float32(126.5 * scheme.scale), f"{y}/top")
    inside = graph.op("Less", halves[1], top, name=f"{y}/fits")
    fine = graph.op("Mul", halves[1], graph.const(np.float32(1 / FINE), f"{y}/unit"), name=f"{y}/fine_scaled")
    quantizer.twins[y] = graph.op("Where", inside, fine, halves[0], name=f"{y}/magnitude")
