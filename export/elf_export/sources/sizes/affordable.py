"""Whether a model can be run at a size at all, before it is tried."""

from __future__ import annotations

import math

import numpy as np
import onnx
from onnx import helper

from elf_export.errors import ExportError
from elf_export.graph.graph import GraphView
from elf_export.graph.image_input import ImageInput

MOST = 2 << 30  # bytes that one node may read and write


def require_affordable(model: onnx.ModelProto, image: ImageInput) -> None:
    """Raise ExportError where the image of `model`, whose sizes are fixed, or a node's maps, are beyond MOST.

    Sizes are those that shape inference finds; where it finds none, the model's weights bound what it can do.
    """
    graph = GraphView(model)
    batch, height, width = ((graph.shape(image.name) or [])[image.layout.index(a)] for a in "NHW")
    at = f"{batch} image(s) of {width}x{height} pixels, as its file states,"
    if None in image.size:
        at = f"an image of {width}x{height} pixels"
    whole = _bytes(graph, image.name)
    if whole > MOST:
        raise ExportError(f"{at} take {whole / 2**30:.1f} GiB; export the model again with a smaller or a free size")
    for node in graph.nodes:
        total = sum(_bytes(graph, name) for name in {*node.input, *node.output} if name)
        if total > MOST:
            raise ExportError(
                f"on {at} its node {(node.name or node.output[0])[:80]!r} ({node.op_type}) alone reads and writes "
                f"{total / 2**30:.3g} GiB, and {MOST >> 30} are the most; export the model again with a smaller or a "
                "free size, or choose a layer before it"
            )


def _bytes(graph: GraphView, name: str) -> int:
    shape = graph.shape(name)
    if shape is None or not all(isinstance(d, int) for d in shape):
        return 0
    try:
        size = np.dtype(helper.tensor_dtype_to_np_dtype(graph.elem_type(name))).itemsize
    except (KeyError, TypeError):  # text
        size = 1
    return math.prod(max(d, 0) for d in shape if isinstance(d, int)) * size
