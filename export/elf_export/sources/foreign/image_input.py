"""Which input of a model is the image, and how its axes lie."""

from __future__ import annotations

import onnx
from onnx import TensorProto

from elf_export.errors import ExportError
from elf_export.graph.graph import GraphView
from elf_export.graph.image_input import ImageInput
from elf_export.graph.layout import COLOR_CHANNELS, layout_of, static_size

PIXEL_TYPES = (
    TensorProto.FLOAT,
    TensorProto.FLOAT16,
    TensorProto.BFLOAT16,
    TensorProto.DOUBLE,
    TensorProto.UINT8,
)


def find_image_input(model: onnx.ModelProto, name: str | None = None) -> ImageInput:
    """The image among a model's inputs: of rank 4, with an axis of 1 or 3 channels.

    The axis is told by its size; where that is not stated, by the first Conv's kernel.

    Parameters
    ----------
    name : str, optional
        As in ``--input``.

    Raises
    ------
    ExportError
        If there is no such input, several, or an image of another shape.
    """
    graph = GraphView(model)
    inputs = [value.name for value in model.graph.input]
    listing = "\n".join(f"  {n}: {_described(graph, n)}" for n in inputs)
    if name is not None:
        if name not in inputs:
            raise ExportError(f"--input: the model has no input {name!r}; it has\n{listing}")
        found = _as_image(graph, name)
        if found is None:
            raise ExportError(
                f"--input: {name!r} is {_described(graph, name)}; an image is (N, C, H, W) or (N, H, W, C) with 1 "
                "or 3 channels, of floats or uint8"
            )
        return found
    images = [image for image in (_as_image(graph, n) for n in inputs) if image is not None]
    if len(images) == 1:
        return images[0]
    if images:
        names = ", ".join(image.name for image in images)
        raise ExportError(
            f"several inputs may be the image: {names}; name it with --input.  The model takes\n{listing}"
        )
    raise ExportError(
        "no input looks like an image, (N, C, H, W) or (N, H, W, C) with 1 or 3 channels.  The model takes\n" + listing
    )


def _as_image(graph: GraphView, name: str) -> ImageInput | None:
    shape = graph.shape(name)
    if shape is None or len(shape) != 4 or graph.elem_type(name) not in PIXEL_TYPES:
        return None
    layout, channels = layout_of(graph, name, shape)
    if channels not in COLOR_CHANNELS:
        return None
    n, h, w = (shape["NCHW".index(a) if layout == "NCHW" else "NHWC".index(a)] for a in "NHW")
    return ImageInput(name, layout, channels, (static_size(n), static_size(h), static_size(w)))


def _described(graph: GraphView, name: str) -> str:
    shape = graph.shape(name)
    dims = "of unknown rank" if shape is None else "(" + ", ".join("?" if d is None else str(d) for d in shape) + ")"
    return f"{TensorProto.DataType.Name(graph.elem_type(name)).lower()} {dims}"
