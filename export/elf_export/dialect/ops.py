"""What each operation of the exporter's own domain computes.

Each gives a value of the shape and the type of its LAST input: that is all that shape inference asks of them.  Windows
are those of the operator whose gradient it is, with its attributes as ONNX has them (kernel_shape, strides, dilations,
pads, auto_pad, ceil_mode); place i of window m is  s m + d t - p  for an offset t in the window.
"""

from __future__ import annotations

from dataclasses import dataclass

import onnx

from elf_export.graph.nodes import OWN


@dataclass(frozen=True)
class Op:
    """An operation: its inputs, in order, and what its result is.

    Attributes
    ----------
    inputs : names; the last one's shape is the result's
    equation : str
    attributes : names of those that it has
    """

    inputs: tuple[str, ...]
    equation: str
    attributes: tuple[str, ...] = ()


_WINDOW = ("kernel_shape", "strides", "dilations", "pads", "auto_pad")

OPS = {
    # v of any shape
    "Step": Op(("v",), "1 where v > 0, else 0"),
    # y of any shape; low and high are scalars, or left out
    "Between": Op(("low", "high", "y"), "1 where low < y < high, else 0"),
    # mask of any shape, of zeros and ones
    "Complement": Op(("mask",), "1 - mask"),
    # dy, y: (N, C, out...), x: (N, C, in...)
    "MaxPoolGrad": Op(
        ("dy", "y", "x"),
        "dx_i = sum of dy_m over all windows m in which i is the FIRST place in raster order with x_i = y_m",
        (*_WINDOW, "ceil_mode"),
    ),
    # dy: (N, C, out...), x: (N, C, in...); scale is a scalar, or left out
    "WindowSum": Op(
        ("dy", "scale", "x"), "dx_i = scale * sum of dy_m over all windows m that hold i", (*_WINDOW, "ceil_mode")
    ),
    # dy: (N, O, out...), W: (O, I/g, k...), x: (N, I, in...)
    "ConvGrad": Op(
        ("dy", "W", "x"),
        "dx_i = sum of W_t^T dy_m over all windows m and offsets t that meet at i",
        (*_WINDOW, "group"),
    ),
}


def is_own(node: onnx.NodeProto, op: str = "") -> bool:
    """Whether a node is one of these; `op`, if one of them is meant."""
    return bool(node.domain == OWN and op in ("", node.op_type))
