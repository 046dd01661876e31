"""Windows that slide: strides, dilations and pads of Conv and the pools.

The number of spatial axes is called n.  Along one axis, window m of an input of size H padded by
(begin, end) starts at padded position ``m * stride`` and looks at offsets ``0, d, 2d ... (k-1)d``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import onnx

from .graph import GraphView, attributes
from .nodes import OWN


@dataclass(frozen=True)
class Window:
    """The sliding window of one node; all tuples have n entries."""

    kernel: tuple[int, ...]
    strides: tuple[int, ...]
    dilations: tuple[int, ...]
    begin: tuple[int, ...] | None  # None: auto_pad SAME_* with a stride, known at run time only
    end: tuple[int, ...]  # an upper bound where `begin` is None
    same_lower: bool = False
    ceil: bool = False

    @property
    def extent(self) -> tuple[int, ...]:
        """Pixels that the window spans: (k - 1) d + 1."""
        return tuple((k - 1) * d + 1 for k, d in zip(self.kernel, self.dilations, strict=True))

    @property
    def padded(self) -> bool:
        return self.begin is None or any(self.begin) or any(self.end) or self.ceil

    @property
    def spatial_axes(self) -> list[int]:
        return list(range(2, 2 + len(self.kernel)))


def window_of(graph: GraphView, node: onnx.NodeProto, kernel: Sequence[int]) -> Window:
    """The window of a Conv or pool node, or of its gradient, auto_pad resolved as far as possible without a size."""
    n = len(kernel)
    a = attributes(node)
    strides = tuple(a.get("strides", [1] * n))
    dilations = tuple(a.get("dilations", [1] * n))
    pads = list(a.get("pads", [0] * 2 * n))
    auto = a.get("auto_pad", "NOTSET")
    begin: tuple[int, ...] | None = tuple(pads[:n])
    end = tuple(pads[n:])
    extent = [(k - 1) * d + 1 for k, d in zip(kernel, dilations, strict=True)]
    if auto == "VALID":
        begin = end = (0,) * n
    elif auto in ("SAME_UPPER", "SAME_LOWER"):
        totals = _same_totals(graph, node, extent, strides)
        if totals is None:
            begin, end = None, tuple(e - 1 for e in extent)
        else:
            small, large = tuple(t // 2 for t in totals), tuple(t - t // 2 for t in totals)
            begin, end = (small, large) if auto == "SAME_UPPER" else (large, small)
    ceil = bool(a.get("ceil_mode", 0))
    return Window(tuple(kernel), strides, dilations, begin, end, auto == "SAME_LOWER", ceil)


def _same_totals(
    graph: GraphView, node: onnx.NodeProto, extent: Sequence[int], strides: Sequence[int]
) -> list[int] | None:
    """Total padding per axis under auto_pad SAME, None where it depends on a size that is not static."""
    x = node.input[-1 if node.domain == OWN else 0]
    sizes = (graph.shape(x) or [None] * (2 + len(extent)))[2:]
    totals = []
    for e, s, size in zip(extent, strides, sizes, strict=True):
        if isinstance(size, int):
            totals.append(max((math.ceil(size / s) - 1) * s + e - size, 0))
        elif s == 1:
            totals.append(e - 1)
        else:
            return None
    return totals
