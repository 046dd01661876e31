"""Masks in integers, exactly zero or one.

The steps [d > 0] that mask gradients, and products with them, cost nothing in precision: what takes the difference d of
two rounded values and is rounded itself, so coarsely that one level of difference saturates, gives exactly zero or one.
A ReLU's mask are its integers, clipped to 0 and 1; one minus a mask are the mask's integers, read otherwise.
"""

from __future__ import annotations

import numpy as np
import onnx

from elf_export.graph.graph import attributes

from .candidates import is_convolution, is_steep, makes_step
from .convolve import convolve
from .quantizer import Quantizer
from .scheme import LEVELS, Scheme, reaching


def mask(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
    """The node as a mask in integers; False where it is none, or its values are no integers."""
    if node.op_type == "HardSigmoid" and _is_step_of_difference(quantizer, node):
        return _step(quantizer, node, quantizer.makers[node.input[0]])
    if node.op_type == "Sign" or is_steep(node):
        return _sign(quantizer, node) or _between(quantizer, node)
    return False


def _is_step_of_difference(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
    """Whether the HardSigmoid makes a mask of a difference of its own."""
    maker = quantizer.makers.get(node.input[0])
    return maker is not None and is_convolution(quantizer.source, maker) and makes_step(quantizer.readers, maker)


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


def _sign(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
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
    y = _clipped_between(quantizer, node)
    if y is None:
        return False
    graph, scheme, name = quantizer.graph, quantizer.rounding[y], node.output[0]
    unit = graph.const(np.float32(-1 / ((LEVELS - 5) * scheme.scale)), f"{name}/room_scale")
    zero = graph.const(np.uint8(LEVELS), f"{name}/room_zero")
    room = graph.op("DequantizeLinear", quantizer.integers[y], unit, zero, name=f"{name}/room")
    graph.op("Mul", quantizer.twins[y], room, name=node.name or name, outputs=[name])
    quantizer.round_mask(name)
    return True


def _clipped_between(quantizer: Quantizer, node: onnx.NodeProto) -> str | None:
    """y of the step of y (top - y), if y is rounded to levels from 0 to top."""
    room = quantizer.makers.get(node.input[0])
    if room is None or room.op_type != "Mul":
        return None
    y, below = room.input
    difference = quantizer.makers.get(below)
    if difference is None or difference.op_type != "Sub" or difference.input[1] != y or not quantizer.is_rounded(y):
        return None
    top, scheme = quantizer.source.constant(difference.input[0]), quantizer.rounding[y]
    reaches = top is not None and top.ndim == 0 and scheme.zero == 0 and scheme == reaching(float(top))
    return y if reaches else None


def complement(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
    """1 - m of a mask m, a convolution in floats: the mask's integers, read from their other end; False where none.

    With m = s (q - z),  1 - m = -s (q - (z + 1 / s)).
    """
    x, name = node.input[0], node.output[0]
    readers = quantizer.readers.get(name, [])
    factor = name not in quantizer.outputs and all(reader.op_type == "Mul" for reader in readers)
    if x not in quantizer.masks or not factor or not _takes_from_one(quantizer, node):
        return False
    scheme = quantizer.rounding[x]
    quantizer.dequantize(name, quantizer.integers[x], Scheme(-scheme.scale, scheme.zero + round(1 / scheme.scale)))
    quantizer.masks.add(name)
    return True


def _takes_from_one(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
    """Whether the Conv is 1 - x, value by value."""
    if len(node.input) < 3:
        return False
    kernel, bias = (quantizer.source.constant(name) for name in node.input[1:])
    given = attributes(node)
    alone = kernel is not None and kernel.shape == (given.get("group", 1), 1, 1, 1)
    stays = set(given.get("strides", [1])) == {1} and not any(given.get("pads", [0]))
    return bool(alone and stays and np.all(kernel == -1) and bias is not None and np.all(bias == 1))
