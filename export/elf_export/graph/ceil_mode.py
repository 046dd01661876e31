"""Pools that round their number of windows up, where ONNX's shape inference counts one window too many.

Along an axis of H pixels, p places of padding in front and q behind, windows of extent e every s places number
ceil((H + p + q - e) / s) + 1; but ONNX Runtime, as torch, has none that begins behind the pixels, at H + p or later,
and onnx 1.23's inference, which is ONNX Runtime's too, counts it.  Where sizes are static, what is derived from them is
then wrong.  The same pool rounding down has the sizes that it says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import onnx
from onnx import helper

from .nodes import attributes

CEIL_POOLS = frozenset({"MaxPool", "AveragePool"})


def floor_mode_pads(given: Mapping[str, Any], sizes: Sequence[int]) -> list[int] | None:
    """The padding with which a pool that rounds down has the windows of this one, which rounds up.

    Parameters
    ----------
    given : mapping
        The pool's attributes.
    sizes : n ints
        Of its input, behind N and C.

    Returns
    -------
    2 n ints, or None
        None where inference is right, and where rounding down would average over more places: with
        ``count_include_pad`` the padding counts, and what rounding up adds to it does not.
    """
    kernel = given["kernel_shape"]
    n, auto = len(kernel), given.get("auto_pad", "NOTSET")
    if not given.get("ceil_mode", 0) or auto.startswith("SAME"):
        return None
    pads = given.get("pads", [0] * 2 * n) if auto == "NOTSET" else [0] * 2 * n
    strides, dilations = (given.get(key, [1] * n) for key in ("strides", "dilations"))
    wrong, ends = False, []
    for size, p, q, k, s, d in zip(sizes, pads[:n], pads[n:], kernel, strides, dilations, strict=True):
        extent = (k - 1) * d + 1
        last = -(-(size + p + q - extent) // s) * s
        if last >= size + p:
            wrong, last = True, last - s
        ends.append(max(last + extent - size - p, 0))
    beyond = any(end > q for end, q in zip(ends, pads[n:], strict=True))
    if not wrong or (beyond and given.get("count_include_pad", 0)):
        return None
    return [*pads[:n], *ends]


def rounds_up(node: onnx.NodeProto) -> bool:
    """Whether a node is a pool in ceil_mode."""
    return node.op_type in CEIL_POOLS and bool(attributes(node).get("ceil_mode", 0))


def in_floor_mode(pool: onnx.NodeProto, sizes: Sequence[int]) -> bool:
    """Write a pool, of an input of these sizes behind N and C, so that it rounds down; False where it stays as it is.

    It stays where some of the sizes are not known.
    """
    given = attributes(pool)
    pads = floor_mode_pads(given, sizes) if len(sizes) == len(given["kernel_shape"]) else None
    if pads is None:
        return False
    kept = {key: value for key, value in given.items() if key not in ("auto_pad", "ceil_mode")}
    del pool.attribute[:]
    pool.attribute.extend(helper.make_attribute(key, value) for key, value in (kept | {"pads": pads}).items())
    return True
