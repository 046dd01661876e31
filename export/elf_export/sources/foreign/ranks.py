"""Numbers of axes that shape inference does not tell, such as those behind a Loop, stated in the graph."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import helper, numpy_helper

from elf_export.errors import ExportError
from elf_export.graph.cost import sizes_of
from elf_export.graph.graph import Graph, GraphView
from elf_export.graph.image_input import ImageInput
from elf_export.graph.sizes import Sizes, with_sizes

AT = ((96, 128), (128, 224))  # about so many pixels of height and width, which differ in each


def with_ranks(model: onnx.ModelProto, image: ImageInput, sizes: Sizes) -> onnx.ModelProto:
    """`model` with a Reshape to its own sizes behind each value of unknown rank whose rank a run tells.

    The length of a list of sizes counts too: as a Reshape's target it is the rank of what that one makes.  Rules and
    checks need ranks; what is the same number at two sizes of the image is taken to be it at every size.
    """
    graph = GraphView(model)
    unknown = [name for node in graph.nodes for name in node.output if name and graph.rank(name) is None]
    for name in unknown:
        if GraphView(model).rank(name) is None and (shape := _kept_shape(model, image, sizes, name)) is not None:
            model = _reshaped(model, name, shape)
    return model


def _kept_shape(model: onnx.ModelProto, image: ImageInput, sizes: Sizes, name: str) -> list[int] | None:
    """The target of a Reshape that keeps a value as it is: 0 stands for an axis of any size."""
    try:
        small, large = (
            sizes_of(GraphView(with_sizes(model, image, Sizes(*sizes.near(*size), 1))), [name])[name] for size in AT
        )
    except ExportError:  # a sequence, which has no sizes
        return None
    if len(small) != len(large):
        return None
    integers = GraphView(model).elem_type(name) == onnx.TensorProto.INT64
    return small if integers and len(small) == 1 and small == large else [0] * len(small)


def _reshaped(model: onnx.ModelProto, name: str, shape: list[int]) -> onnx.ModelProto:
    graph = Graph(model)
    before, target = graph.unique(f"{name}/any_rank"), graph.unique(f"{name}/own_sizes")
    result = onnx.ModelProto()
    result.CopyFrom(model)
    nodes = list(result.graph.node)
    place = next(i for i, node in enumerate(nodes) if name in node.output)
    nodes[place].output[list(nodes[place].output).index(name)] = before
    result.graph.initializer.append(numpy_helper.from_array(np.array(shape, np.int64), target))
    result.graph.node.insert(place + 1, helper.make_node("Reshape", [before, target], [name], name=f"{name}/rank"))
    return result
