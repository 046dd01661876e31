"""Where the cells of a feature map lie in the image: stride, offset and receptive field of every value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import onnx

from .graph import SIZES, GraphView, attributes
from .layout import image_layout
from .shapes import without_weights
from .windows import window_of

WORKING_SIZE = (480, 640)  # the paper's, height and width
NEAR = 0.2  # of a ratio of strides: what cells at the border change about it
GLOBAL = frozenset({
    "GlobalAveragePool", "GlobalMaxPool", "GlobalLpPool", "MatMul", "Gemm", "Einsum", "CumSum", "Softmax", "LSTM",
    "GRU",
})  # fmt: skip


@dataclass(frozen=True)
class Field:
    """Along one axis: cell i is centred at pixel ``offset + i * stride`` and sees `size` pixels.

    `size` is infinite where a cell sees the whole image, and NaN where `measured` can't tell.
    """

    stride: float = 1.0
    offset: float = 0.0
    size: float = 1.0


At = tuple[Sequence[int], Sequence[int]]  # an image's height and width, and a map's of it


def measured(field: Field, image: Sequence[int], cells: Sequence[int], larger: At | None = None) -> Field:
    """`field`, held against the sizes of the image and of the map, (height, width) each.

    Where the walk over the nodes does not explain a map's size (a Resize to computed sizes, a space-to-depth
    written in Slices), the cells are taken to tile the image, and `size` is NaN: what they see is not known.
    Where their sides differ, the width decides.

    Parameters
    ----------
    larger : optional
        A larger image and its map.  What is padded to whole windows has more cells than its stride explains, but
        further pixels bring further cells at that stride: it is the walk's, or a simple multiple or part of it, if
        the two sizes speak for that.
    """
    sizes = [(image, cells), *([larger] if larger else [])]
    if all(_explains(field, *pair) for at in sizes for pair in zip(*at, strict=True)):
        return field
    stride = image[1] / cells[1]
    if larger is not None and larger[1][1] > cells[1]:
        stride = _near(field.stride, (larger[0][1] - image[1]) / (larger[1][1] - cells[1]))
        if stride == field.stride:
            return replace(field, size=math.nan)
    return Field(stride, (stride - 1) / 2, math.nan)


def _near(stride: float, slope: float) -> float:
    """The multiple or part of `stride` that `slope` lies close to, or else `slope`."""
    ratio = max(slope / stride, stride / slope)
    whole = round(ratio)
    if abs(ratio - whole) > NEAR * min(whole, 2):
        return slope
    return stride * whole if slope > stride else stride / whole


def stated(size: float) -> float:
    """A field's size for the contract: 0 where it is not known, or the whole image."""
    return size if math.isfinite(size) else 0.0


def _explains(field: Field, pixels: int, cells: int) -> bool:
    """A map may lose or gain a cell at its border, by padding and rounding; without padding it loses its field."""
    lost = pixels / field.stride - cells
    return abs(lost) <= 2 or 0 < lost <= min(field.size / field.stride, cells / 4)


def receptive_fields(model: onnx.ModelProto, image: str, size: Sequence[int] = WORKING_SIZE) -> dict[str, Field]:
    """The field of every value that depends on `image`, along the last spatial axis.

    A window of extent e, stride s and padding p in front, over cells at stride j and offset o, gives

        stride j s,   offset o + ((e - 1) / 2 - p) j,   size r + (e - 1) j

    Other ops are taken as pointwise; where several inputs meet, the largest field decides, and one that sees
    the whole image (the gate of a squeeze-and-excitation) decides the size alone.  What is made of the image's
    sizes alone (a table of positions, enlarged to them) has no field.  Under SAME padding with a
    stride the offset depends on the image's size: it is stated for `size` (height, width), and at another one
    cells may lie up to half a stride of each such layer elsewhere.
    """
    graph = _at_size(model, image, size)
    fields = {image: Field()}
    for node in graph.nodes:
        inputs = [fields[name] for name in node.input if name in fields]
        if not inputs or node.op_type in SIZES:
            continue
        found = max(inputs, key=lambda f: f.size if math.isfinite(f.size) else 0)
        found = replace(found, size=max(f.size for f in inputs))
        if node.op_type in ("Conv", "MaxPool", "AveragePool", "LpPool"):
            found = _windowed(graph, node, found)
        elif node.op_type == "ConvTranspose":
            found = _transposed(graph, node, found)
        elif node.op_type in ("Resize", "Upsample"):
            found = _resized(graph, node, found)
        elif node.op_type in ("DepthToSpace", "SpaceToDepth"):
            block = attributes(node)["blocksize"]
            found = _scaled(found, block if node.op_type == "DepthToSpace" else 1 / block)
        elif node.op_type in GLOBAL:
            found = replace(found, size=math.inf)
        for name in node.output:
            fields[name] = found
    return fields


def _at_size(model: onnx.ModelProto, image: str, size: Sequence[int]) -> GraphView:
    """The model for images of `size`, where the sizes are free, so that inference knows every map's."""
    fixed = without_weights(model)
    del fixed.graph.value_info[:]
    for value in fixed.graph.input:
        dims = value.type.tensor_type.shape.dim
        if value.name == image and len(dims) == 4:
            layout = image_layout(GraphView(fixed), image)
            for dim, pixels in zip((dims[layout.index("H")], dims[layout.index("W")]), size, strict=True):
                if not dim.HasField("dim_value"):
                    dim.dim_value = pixels
    for value in fixed.graph.output:
        # Their symbolic sizes would contradict what inference finds.
        value.type.tensor_type.ClearField("shape")
    return GraphView(fixed)


def _windowed(graph: GraphView, node: onnx.NodeProto, before: Field) -> Field:
    given = attributes(node)
    kernel = given.get("kernel_shape") or [int(d or 1) for d in (graph.shape(node.input[1]) or [])[2:]]
    window = window_of(graph, node, kernel)
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


def _transposed(graph: GraphView, node: onnx.NodeProto, before: Field) -> Field:
    """Cell x goes to the outputs around s x + (e - 1) / 2 - p, of which each sees ceil(e / s) cells."""
    given = attributes(node)
    kernel = given.get("kernel_shape") or [int(d or 1) for d in (graph.shape(node.input[1]) or [])[2:]]
    window = window_of(graph, node, kernel)
    extent, stride = window.extent[-1], window.strides[-1]
    if window.begin is None or given.get("auto_pad", "NOTSET").startswith("SAME"):
        # Not what a Conv of this window would add: every size becomes `stride` times as large.
        total = max(extent + given.get("output_padding", [0])[-1] - stride, 0)
        begin = total - total // 2 if window.same_lower else total // 2
    else:
        begin = window.begin[-1]
    return Field(
        before.stride / stride,
        before.offset + (begin - (extent - 1) / 2) / stride * before.stride,
        before.size + (math.ceil(extent / stride) - 1) * before.stride,
    )


def _resized(graph: GraphView, node: onnx.NodeProto, before: Field) -> Field:
    """The factor is the last of the scales, or the ratio of static sizes; unknown, it is taken for 1."""
    given = attributes(node)
    index = 1 if node.op_type == "Upsample" else 2
    scales = graph.constant(node.input[index]) if len(node.input) > index else None
    if scales is not None and scales.size:
        factor = float(scales[-1])
    else:
        old, new = ((graph.shape(name) or [None])[-1] for name in (node.input[0], node.output[0]))
        factor = new / old if isinstance(old, int) and isinstance(new, int) else 1.0
    if given.get("mode", "nearest") == "nearest":
        return _scaled(before, factor)
    after = _scaled(before, factor)
    if given.get("coordinate_transformation_mode") == "asymmetric":
        after = replace(after, offset=before.offset)
    return replace(after, size=before.size + before.stride)


def _scaled(before: Field, factor: float) -> Field:
    """`factor` cells for each one, the maps' edges coinciding: x = (y + 1/2) / factor - 1/2."""
    return replace(
        before,
        stride=before.stride / factor,
        offset=before.offset + (0.5 / factor - 0.5) * before.stride,
        size=before.size + max(1 / factor - 1, 0) * before.stride,
    )
