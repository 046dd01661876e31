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
from .integers import Rewriting
from .scheme import LEVELS, Scheme, reaching


def mask(state: Rewriting, node: onnx.NodeProto) -> bool:
    """The node as a mask in integers; False where it is none, or its values are no integers."""
    if node.op_type == "HardSigmoid" and _is_step_of_difference(state, node):
        return _step(state, node, state.makers[node.input[0]])
    if node.op_type == "Sign" or is_steep(node):
        return _sign(state, node) or _between(state, node)
    return False


def _is_step_of_difference(state: Rewriting, node: onnx.NodeProto) -> bool:
    """Whether the HardSigmoid makes a mask of a difference of its own."""
    maker = state.makers.get(node.input[0])
    return maker is not None and is_convolution(state.source, maker) and makes_step(state.readers, maker)


def _step(state: Rewriting, node: onnx.NodeProto, difference: onnx.NodeProto) -> bool:
    """[d > 0], d the difference of two rounded values; in floats where they are not."""
    x = difference.input[0]
    kernel = state.source.constant(difference.input[1])
    if not state.is_rounded(x) or kernel is None:
        state.keep(difference)
        state.keep(node)
        return True
    # One level of difference becomes 1, which is the largest number that the result's scheme has.
    convolve(state, difference, x, kernel / state.rounding[x].scale, None, node.output[0])
    state.round_mask(node.output[0])
    return True


def _sign(state: Rewriting, node: onnx.NodeProto) -> bool:
    """[x > 0] of values that are never negative: their integers, clipped to 0 and 1; False where it is none."""
    x, name = node.input[0], node.output[0]
    scheme = state.rounding.get(x)
    if scheme is None or not state.is_rounded(x) or scheme.zero or name in state.outputs:
        return False
    bounds = [state.graph.const(np.uint8(v), f"{name}/{what}") for v, what in ((0, "low"), (1, "high"))]
    q = state.graph.op("Clip", state.integers[x], *bounds, name=f"{name}/q")
    state.dequantize(name, q, Scheme(1.0))
    state.masks.add(name)
    return True


def _between(state: Rewriting, node: onnx.NodeProto) -> bool:
    """[0 < y < top] = [y (top - y) > 0] where top is y's highest level: a product of the integers q and q - 255.

    The second, read with a negative scale, is top - y in a unit in which the smallest product, that of one level with
    the 254 others, is above 1, which is the largest number that the result's scheme has.
    """
    y = _clipped_between(state, node)
    if y is None:
        return False
    graph, scheme, name = state.graph, state.rounding[y], node.output[0]
    unit = graph.const(np.float32(-1 / ((LEVELS - 5) * scheme.scale)), f"{name}/room_scale")
    zero = graph.const(np.uint8(LEVELS), f"{name}/room_zero")
    room = graph.op("DequantizeLinear", state.integers[y], unit, zero, name=f"{name}/room")
    graph.op("Mul", state.twins[y], room, name=node.name or name, outputs=[name])
    state.round_mask(name)
    return True


def _clipped_between(state: Rewriting, node: onnx.NodeProto) -> str | None:
    """y of the step of y (top - y), if y is rounded to levels from 0 to top."""
    room = state.makers.get(node.input[0])
    if room is None or room.op_type != "Mul":
        return None
    y, below = room.input
    difference = state.makers.get(below)
    if difference is None or difference.op_type != "Sub" or difference.input[1] != y or not state.is_rounded(y):
        return None
    top, scheme = state.source.constant(difference.input[0]), state.rounding[y]
    reaches = top is not None and top.ndim == 0 and scheme.zero == 0 and scheme == reaching(float(top))
    return y if reaches else None


def complement(state: Rewriting, node: onnx.NodeProto) -> bool:
    """1 - m of a mask m, a convolution in floats: the mask's integers, read from their other end; False where none.

    With m = s (q - z),  1 - m = -s (q - (z + 1 / s)).
    """
    x, name = node.input[0], node.output[0]
    readers = state.readers.get(name, [])
    factor = name not in state.outputs and all(reader.op_type == "Mul" for reader in readers)
    if x not in state.masks or not factor or not _takes_from_one(state, node):
        return False
    scheme = state.rounding[x]
    state.dequantize(name, state.integers[x], Scheme(-scheme.scale, scheme.zero + round(1 / scheme.scale)))
    state.masks.add(name)
    return True


def _takes_from_one(state: Rewriting, node: onnx.NodeProto) -> bool:
    """Whether the Conv is 1 - x, value by value."""
    if len(node.input) < 3:
        return False
    kernel, bias = (state.source.constant(name) for name in node.input[1:])
    given = attributes(node)
    alone = kernel is not None and kernel.shape == (given.get("group", 1), 1, 1, 1)
    stays = set(given.get("strides", [1])) == {1} and not any(given.get("pads", [0]))
    return bool(alone and stays and np.all(kernel == -1) and bias is not None and np.all(bias == 1))
