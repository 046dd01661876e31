"""Where the cells of a feature map lie in the image: stride, offset and receptive field of every value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import onnx
from onnx import helper

from .adjoint.geometry import window_of
from .adjoint.registry import Context
from .graph import Graph

WORKING_SIZE = (480, 640)  # the paper's, height and width


@dataclass(frozen=True)
class Field:
    """Along one axis: cell i is centred at pixel ``offset + i * stride`` and sees `size` pixels."""

    stride: float = 1.0
    offset: float = 0.0
    size: float = 1.0


def receptive_fields(
    model: onnx.ModelProto, image: str, size: Sequence[int] = WORKING_SIZE
) -> dict[str, Field]:
    """The field of every value that depends on `image`, along the last spatial axis.

    A window of extent e, stride s and padding p in front, over cells at stride j and offset o, gives

        stride j s,   offset o + ((e - 1) / 2 - p) j,   size r + (e - 1) j

    Other ops are taken as pointwise; where several inputs meet, the largest field decides.  Under SAME
    padding with a stride the offset depends on the image's size: it is stated for `size` (height, width), and
    at another one cells may lie up to half a stride of each such layer elsewhere.
    """
    graph = Graph(_resized(model, image, size))
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


def _resized(model: onnx.ModelProto, image: str, size: Sequence[int]) -> onnx.ModelProto:
    """A copy for images of `size`, where the sizes are free, so that inference knows every map's."""
    fixed = onnx.ModelProto()
    fixed.CopyFrom(model)
    del fixed.graph.value_info[:]
    for value in fixed.graph.input:
        dims = value.type.tensor_type.shape.dim
        if value.name == image and len(dims) == 4:
            for dim, pixels in zip((dims[2], dims[3]), size, strict=True):
                if not dim.HasField("dim_value"):
                    dim.dim_value = pixels
    for value in fixed.graph.output:
        # Their symbolic sizes would contradict what inference finds.
        value.CopyFrom(helper.make_tensor_value_info(value.name, value.type.tensor_type.elem_type, None))
    return fixed


def _windowed(graph: Graph, node: onnx.NodeProto, before: Field) -> Field:
    context = Context(graph, node)
    kernel = context.attrs.get("kernel_shape") or [
        int(d or 1) for d in (graph.shape(node.input[1]) or [])[2:]
    ]
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
