"""A foreign model made ready: image and layers found, cut, in an opset and arithmetic that the rules know, freed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import onnx

from elf_export.adjoint import opset_wanted
from elf_export.adjoint.preflight import QUANTISED
from elf_export.errors import ExportError, LayerError
from elf_export.graph.graph import Graph, GraphView, captured
from elf_export.graph.image_input import ImageInput
from elf_export.graph.passes import convert_opset, cut, fold_constants, opset_of, single_precision, without_rounding
from elf_export.graph.passes.without_rounding import QUANTIZERS
from elf_export.graph.sizes import Sizes, with_sizes
from elf_export.sources.geometry import largest_stride
from elf_export.sources.sizes.free import free_sizes

from .image_input import find_image_input
from .layers import resolve_layer
from .ranks import with_ranks
from .unchanged import unchanged


@dataclass(frozen=True)
class Prepared:
    """A foreign model, ready to be differentiated.

    Attributes
    ----------
    model : onnx.ModelProto
        Cut at the layers, in float32, of an opset that the rules know, its sizes freed.
    notes : sentences
        What was changed that a user may wonder about.
    """

    model: onnx.ModelProto
    image: ImageInput
    sizes: Sizes
    layers: tuple[str, ...]
    notes: tuple[str, ...] = ()


def prepare(
    model: onnx.ModelProto,
    layers: Sequence[str],
    image_input: str | None = None,
    opset: int | None = None,
    least_opset: int = 0,
) -> Prepared:
    """Find the image and the layers, cut, convert, and free the sizes.

    Parameters
    ----------
    layers : names
        Of values or nodes, or unique ends of them.
    opset : int, optional
        The model's own by default, moved into 11 to 20, and to a later one where a rule can't do without.
    least_opset : int
        What it is moved to at least, if `opset` isn't given.

    Raises
    ------
    ExportError
        From `find_image_input`, `resolve_layer`, `convert_opset`, `free_sizes` or `unchanged`.
    """
    image = find_image_input(model, image_input)
    names = tuple(resolve_layer(model, layer) for layer in layers)
    trunk = cut(model, list(dict.fromkeys(names)))
    inputs = [value.name for value in trunk.graph.input]
    if image.name not in inputs:
        raise LayerError(f"{', '.join(map(repr, names))} does not depend on the image {image.name!r}")
    if inputs != [image.name]:
        others = ", ".join(repr(name) for name in inputs if name != image.name)
        raise LayerError(f"the layer needs more inputs than the image: {others}; choose one before they come in")
    before, notes = in_floats(single_precision(trunk, [image.name]))
    if opset is None:
        trunk, more = in_known_opset(before, image, names[:1], least_opset)
    else:
        trunk, more = convert_opset(before, opset), ()
    require_floats(trunk, names)
    require_no_rounding(trunk, image)
    trunk, sizes = free_sizes(trunk, image, largest_stride(trunk, image))
    trunk = with_ranks(trunk, image, sizes)
    notes = (*notes, *more, *unchanged(before, trunk, image, sizes))
    return Prepared(trunk, image, sizes, names, notes)


def in_known_opset(
    model: onnx.ModelProto, image: ImageInput, layers: Sequence[str], least: int = 0
) -> tuple[onnx.ModelProto, tuple[str, ...]]:
    """`model` in an opset that the rules know, and what to tell if that took more than moving it into their range.

    Before opset 13 no op sums along axes that are known at run time only, as the gradient of what is repeated there
    needs; a model where that is so is converted.
    """
    own = opset_of(model)
    moved = convert_opset(model)
    free = with_sizes(moved, image, Sizes())
    graph = fold_constants(Graph(free, copy=False))
    wanted = max((opset_wanted(graph, image.name, layer) for layer in layers), default=0)
    if max(wanted, least) <= opset_of(moved):
        return moved, ()
    try:
        return convert_opset(model, max(wanted, least)), (
            f"the model is of opset {own} and was converted to {max(wanted, least)}, which its gradient or the "
            "precision needs",
        )
    except ExportError:  # what needs it says so itself
        return moved, ()


def in_floats(model: onnx.ModelProto) -> tuple[onnx.ModelProto, tuple[str, ...]]:
    """`model` without its quantisation, and what to tell of it."""
    model, quantizers = without_rounding(model)
    if not quantizers:
        return model, ()
    return model, (
        f"the model is quantised: {quantizers} QuantizeLinear and DequantizeLinear were taken out, since what is "
        "rounded has no gradient.  Its weights keep their values of few bits; --precision int8 makes the new file an "
        "8-bit one",
    )


def require_floats(model: onnx.ModelProto, layers: Sequence[str]) -> None:
    """Raise LayerError on a layer of integers, booleans or text."""
    graph = GraphView(model)
    for name in layers:
        kind = onnx.TensorProto.DataType.Name(graph.elem_type(name)).lower()
        if kind != "float":
            raise LayerError(
                f"{name!r} can be no layer: it holds {kind} values, and neither a gradient nor a descriptor is made of "
                "those; choose one of floats (--list shows them)"
            )


def require_no_rounding(model: onnx.ModelProto, image: ImageInput) -> None:
    """Raise LayerError where the image goes through integer arithmetic that could not be taken out."""
    reached = {image.name}
    for node in model.graph.node:
        if reached.intersection((*node.input, *captured(node))):
            reached.update(node.output)
            if node.op_type in QUANTISED or node.op_type in QUANTIZERS:
                raise LayerError(
                    f"the network is quantised in a way that can't be taken out: node {node.name or node.output[0]!r} "
                    f"({node.op_type}) rounds, which has no gradient, and its scale is computed, its integers are "
                    "calculated with, or they have 4 bits; export the float network that it was made from"
                )
