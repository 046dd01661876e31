"""`--onnx FILE --list`: the layers of anyone's model."""

from __future__ import annotations

import contextlib
import os

import onnx

from elf_export.errors import ExportError
from elf_export.graph.image_input import ImageInput
from elf_export.graph.passes import cut, single_precision
from elf_export.graph.sizes import USUAL, Sizes, with_sizes
from elf_export.sources.foreign.guard import only_export_errors
from elf_export.sources.foreign.image_input import find_image_input
from elf_export.sources.foreign.load import load_model
from elf_export.sources.foreign.prepare import Prepared, in_floats, in_known_opset
from elf_export.sources.geometry import largest_stride, layer_fields
from elf_export.sources.sizes.affordable import require_affordable
from elf_export.sources.sizes.free import free_sizes

from .listing import layer_table, map_layers


def model_table(file: str | os.PathLike[str], image_input: str | None = None) -> str:
    """All maps that the image goes through, as an export finds them, at the file's own size where it states one."""
    with only_export_errors(file):
        model = load_model(file)
        image = find_image_input(model, image_input)
        if image.name not in {value.name for value in cut(model, [v.name for v in model.graph.output]).graph.input}:
            raise ExportError(f"none of the model's outputs depends on the image {image.name!r}")
        require_affordable(_at_own_size(model, image), image)
        model, notes = in_floats(single_precision(model, [image.name]))
        more: tuple[str, ...] = ()
        # A head that the converter stops at is no reason to hide the layers before it.
        with contextlib.suppress(ExportError):
            model, more = in_known_opset(model, image, [value.name for value in model.graph.output])
        source = _freed(model, image)
        sizes = source.sizes
        height, width = sizes.near(image.size[1] or USUAL, image.size[2] or USUAL)
        shown = with_sizes(model, image, Sizes(height, width, sizes.batch or 1))
        table = layer_table(shown, image.name, fields=layer_fields(source.model, image, sizes, source.layers))
        return "\n".join([*notes, *more, f"images: {sizes.describe()}", table])


def _freed(model: onnx.ModelProto, image: ImageInput) -> Prepared:
    """The model cut at all of its maps, its sizes freed; as it stands where that can't be run by the image alone."""
    batch, height, width = (size or 0 for size in image.size)
    sizes = Sizes(height, width, batch)
    if not (height and width):
        # Which values are maps is told at a size that the model takes.
        with contextlib.suppress(ExportError):
            _, sizes = free_sizes(model, image, largest_stride(model, image))
    layers = tuple(map_layers(_at_own_size(model, image, sizes), image.name))
    source = Prepared(model, image, sizes, layers)
    if not layers:
        return source
    trunk = cut(model, layers)
    with contextlib.suppress(ExportError):
        trunk, sizes = free_sizes(trunk, image, largest_stride(trunk, image))
        return Prepared(trunk, image, sizes, layers)
    return source


def _at_own_size(model: onnx.ModelProto, image: ImageInput, sizes: Sizes | None = None) -> onnx.ModelProto:
    batch, height, width = image.size
    usual = USUAL if sizes is None else sizes.usual
    return with_sizes(model, image, Sizes(height or usual, width or usual, batch or 1))
