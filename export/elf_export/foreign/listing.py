"""`--onnx FILE --list`: the layers of anyone's model."""

from __future__ import annotations

import contextlib
import os

from elf_export.errors import ExportError
from elf_export.listing import layer_table
from elf_export.passes import convert_opset, single_precision

from .free_sizes import Sizes, with_sizes
from .image_input import find_image_input
from .load import load_model


def model_table(file: str | os.PathLike[str], image_input: str | None = None) -> str:
    """All maps that the image goes through, at the file's own size where it states one."""
    model = load_model(file)
    image = find_image_input(model, image_input)
    model = single_precision(model, [image.name])
    # A head that the converter stops at is no reason to hide the layers before it.
    with contextlib.suppress(ExportError):
        model = convert_opset(model)
    batch, height, width = (size or 0 for size in image.size)
    return layer_table(with_sizes(model, image, Sizes(height, width, batch)), image.name)
