"""Masks in integers, exactly zero or one.

The steps [d > 0] that mask gradients, and products with them, cost nothing in precision: what takes the difference d of
two rounded values and is rounded itself, so coarsely that one level of difference saturates, gives exactly zero or one.
A ReLU's mask are its integers, clipped to 0 and 1; one minus a mask are the mask's integers, read otherwise.
"""

from __future__ import annotations

import numpy as np
import onnx

from elf_export.dialect import is_own

from .candidates import is_convolution, makes_step
from .convolve import convolve
from .quantizer import Quantizer
from .scheme import LEVELS, Scheme, reaching


def mask(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
    """The node as a mask in integers; False where it is none, or its values are no integers."""
    if is_own(node, "Step"):
        maker = quantizer.makers.get(node.input[0])
        if maker is not None and is_convolution(quantizer.source, maker) and makes_step(quantizer.readers, maker):
            return _step(quantizer, node, maker)
        return _positive(quantizer, node)
    return (is_own(node, "Between") and _between(quantizer, node)) or (
        is_own(node, "Complement") and _complement(quantizer, node)
    )


def _step(quantizer: Quantizer, node: onnx.NodeProto, difference: onnx.NodeProto) -> bool:
    """[d > 0], d the difference of two rounded values; in floats where they are not."""
    x = difference.input[0]
    kernel = quantizer.source.constant(difference.input[1])
    if not quantizer.is_rounded(x) or kernel is None:
        quantizer.keep(difference)
        quantizer.keep(node)
        return True
    # One level of difference becomes 1, which is the largest number that the result's scheme has.
    convolve(quantizer, difference, x, kernel / quantizer.rounding[x].scale, None, node.output[0])
    quantizer.round_mask(node.output[0])
    return True


def _positive(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
    """[x > 0] of values that are never negative: their integers, clipped to 0 and 1; False where it is none."""
    x, name = node.input[0], node.output[0]
    scheme = quantizer.rounding.get(x)
    if scheme is None or not quantizer.is_rounded(x) or scheme.zero or name in quantizer.outputs:
        return False
    bounds = [quantizer.graph.const(np.uint8(v), f"{name}/{what}") for v, what in ((0, "low"), (1, "high"))]
    q = quantizer.graph.op("Clip", quantizer.integers[x], *bounds, name=f"{name}/q")
    quantizer.dequantize(name, q, Scheme(1.0))
    quantizer.masks.add(name)
    return True


def _between(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
    """[0 < y < top] = [y (top - y) > 0] where top is y's highest level: a product of the integers q and q - 255.

    The second, read with a negative scale, is top - y in a unit in which the smallest product, that of one level with
    the 254 others, is above 1, which is the largest number that the result's scheme has.
    """
    low, high, y = node.input
    bottom, top = (quantizer.source.constant(bound) for bound in (low, high))
    if not quantizer.is_rounded(y) or bottom is None or bottom.any() or top is None or top.ndim > 0:
        return False
    graph, scheme, name = quantizer.graph, quantizer.rounding[y], node.output[0]
    if scheme.zero or scheme != reaching(float(top)):
        return False
    unit = graph.const(np.float32(-1 / ((LEVELS - 5) * scheme.scale)), f"{name}/room_scale")
    zero = graph.const(np.uint8(LEVELS), f"{name}/room_zero")
    room = graph.op("DequantizeLinear", quantizer.integers[y], unit, zero, name=f"{name}/room")
    graph.op("Mul", quantizer.twins[y], room, name=node.name or name, outputs=[name])
    quantizer.round_mask(name)
    return True


def _complement(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
    """1 - m of a mask m that is a factor: the mask's integers, read from their other end; False where it is none.

    With m = s (q - z),  1 - m = -s (q - (z + 1 / s)).
    """
    x, name = node.input[0], node.output[0]
    factor = all(reader.op_type == "Mul" for reader in quantizer.readers.get(name, []))
    if x not in quantizer.masks or name in quantizer.outputs or not factor:
        return False
    scheme = quantizer.rounding[x]
    quantizer.dequantize(name, quantizer.integers[x], Scheme(-scheme.scale, scheme.zero + round(1 / scheme.scale)))
    quantizer.masks.add(name)
    return True
