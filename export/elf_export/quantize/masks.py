"""Masks in integers, exactly zero or one.

The steps [d > 0] that mask gradients, and products with them, cost nothing in precision: what takes the difference d of
two rounded values and is rounded itself, so coarsely that one level of difference saturates, gives exactly zero or one.
"""

from __future__ import annotations

import numpy as np
import onnx

from .choice import is_convolution, is_steep, makes_step
from .convolve import convolve
from .scheme import LEVELS, reaching
from .state import Rewriting


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
    return maker is not None and is_convolution(state.graph, maker) and makes_step(state.readers, maker)


def _step(state: Rewriting, node: onnx.NodeProto, difference: onnx.NodeProto) -> bool:
    """[d > 0], d the difference of two rounded values; in floats where they are not."""
    x = difference.input[0]
    kernel = state.graph.constant(difference.input[1])
    if not state.is_rounded(x) or kernel is None:
        state.keep(difference)
        state.keep(node)
        return True
    # One level of difference becomes 1, which is the largest number that the result's scheme has.
    convolve(state, difference, x, kernel / state.rounding[x].scale, None, node.output[0])
    state.round_mask(node.output[0])
    return True


def _sign(state: Rewriting, node: onnx.NodeProto) -> bool:
    """[x > 0] of values that are never negative, as a step; False where it is none."""
    x, shape = node.input[0], state.graph.shape(node.input[0]) or []
    scheme = state.rounding.get(x)
    if scheme is None or not state.is_rounded(x) or scheme.zero or len(shape) != 4 or not isinstance(shape[1], int):
        return False
    kernel = np.ones((shape[1], 1, 1, 1))
    difference = onnx.helper.make_node(
        "Conv", [x], [node.output[0]], name=node.name, group=shape[1], kernel_shape=[1, 1]
    )
    convolve(state, difference, x, kernel / scheme.scale, None, node.output[0])
    state.round_mask(node.output[0])
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
    top, scheme = state.graph.constant(difference.input[0]), state.rounding[y]
    reaches = top is not None and top.ndim == 0 and scheme.zero == 0 and scheme == reaching(float(top))
    return y if reaches else None
