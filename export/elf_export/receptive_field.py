"""Where the cells of a feature map lie in the image: stride, offset and receptive field of every value."""

from __future__ import annotations

from dataclasses import dataclass

import onnx

from .adjoint.geometry import window_of
from .adjoint.registry import Context
from .graph import Graph


@dataclass(frozen=True)
class Field:
    """Along one axis: cell i is centred at pixel ``offset + i * stride`` and sees `size` pixels."""

    stride: float = 1.0
    offset: float = 0.0
    size: float = 1.0


def receptive_fields(graph: Graph, image: str) -> dict[str, Field]:
    """The field of every value that depends on `image`, along the last spatial axis.

    A window of extent e, stride s and padding p in front, over cells at stride j and offset o, gives

        stride j s,   offset o + ((e - 1) / 2 - p) j,   size r + (e - 1) j

    Other ops are taken as pointwise; where several inputs meet, the largest field decides.  Under a run-time
    SAME padding the offset is that of an input whose size the stride divides.
    """
    fields = {image: Field()}
    for node in graph.nodes:
        inputs = [fields[name] for name in node.input if name in fields]
        if not inputs:
            continue
        found = max(inputs, key=lambda f: f.size)
        if node.op_type in ("Conv", "MaxPool", "AveragePool", "LpPool"):
            found = _windowed(graph, node, found)
        for name in node.output:
            fields[name] = found
    return fields


def _windowed(graph: Graph, node: onnx.NodeProto, before: Field) -> Field:
    context = Context(graph, node)
    kernel = context.attrs.get("kernel_shape") or [int(d or 1) for d in (graph.shape(node.input[1]) or [])[2:]]
    window = window_of(context, kernel)
    extent, stride = window.extent[-1], window.strides[-1]
    if window.begin is not None:
        begin = window.begin[-1]
    else:
        total = max(extent - stride, 0)
        begin = total - total // 2 if window.same_lower else total // 2
    return Field(
        before.stride * stride,
        before.offset + ((extent - 1) / 2 - begin) * before.stride,
        before.size + (extent - 1) * before.stride,
    )
