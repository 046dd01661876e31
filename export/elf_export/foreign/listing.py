"""`--onnx FILE --list`: the layers of anyone's model."""

from __future__ import annotations

import contextlib
import os

import onnx

from elf_export.errors import ExportError
from elf_export.listing import layer_table, map_layers
from elf_export.passes import cut, single_precision

from .affordable import require_affordable
from .free_sizes import Sizes, free_sizes, with_sizes
from .guard import only_export_errors
from .image_input import ImageInput, find_image_input
from .load import load_model
from .source import Source, in_floats, in_known_opset, largest_stride, layer_fields

SHOWN_AT = 512  # about so many pixels of height and width, where the file fixes no size


def model_table(file: str | os.PathLike[str], image_input: str | None = None) -> str:
    """All maps that the image goes through, as an export finds them, at the file's own size where it states one."""
    with only_export_errors(file):
        model = load_model(file)
        image = find_image_input(model, image_input)
        require_affordable(_at_own_size(model, image), image)
        model = single_precision(model, [image.name])
        notes: tuple[str, ...] = ()
        # A head that the converter stops at is no reason to hide the layers before it.
        with contextlib.suppress(ExportError):
            model, notes = in_known_opset(model, image, [value.name for value in model.graph.output])
        model, more = in_floats(model)
        source = _freed(model, image)
        sizes = source.sizes
        height, width = sizes.near(image.size[1] or SHOWN_AT, image.size[2] or SHOWN_AT)
        shown = with_sizes(model, image, Sizes(height, width, sizes.batch or 1))
        table = layer_table(shown, image.name, fields=layer_fields(source, source.layers))
        return "\n".join([*notes, *more, f"images: {sizes.describe()}", table])


def _freed(model: onnx.ModelProto, image: ImageInput) -> Source:
    """The model cut at all of its maps, its sizes freed; as it stands where that can't be run by the image alone."""
    layers = tuple(map_layers(_at_own_size(model, image), image.name))
    batch, height, width = (size or 0 for size in image.size)
    source = Source(model, image, Sizes(height, width, batch), layers)
    if not layers:
        return source
    trunk = cut(model, layers)
    with contextlib.suppress(ExportError):
        trunk, sizes = free_sizes(trunk, image, largest_stride(trunk, image))
        return Source(trunk, image, sizes, layers)
    return source


def _at_own_size(model: onnx.ModelProto, image: ImageInput) -> onnx.ModelProto:
    batch, height, width = image.size
    return with_sizes(model, image, Sizes(height or SHOWN_AT, width or SHOWN_AT, batch or 1))
