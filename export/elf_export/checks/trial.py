"""The finished file, used as its user will: whether the runtime takes it."""

from __future__ import annotations

import math

import numpy as np
import onnx

from elf_export.errors import ExportError
from elf_export.file import stamped
from elf_export.graph.sizes import Sizes
from elf_runtime import ElfRuntime, ModelContract
from elf_runtime.errors import ElfError, first_line

from .pictures import grainy

AT = ((97, 131), (240, 320))  # about so many pixels of height and width, beside the smallest image


def require_usable(model: onnx.ModelProto, contract: ModelContract, sizes: Sizes) -> None:
    """Raise ExportError if the runtime does not find and describe keypoints with the file, on images that it states."""
    elf = ElfRuntime(stamped(model, contract))
    for size in dict.fromkeys([sizes.near(sizes.min_size, sizes.min_size), *(sizes.near(*at) for at in AT)]):
        height, width = (math.ceil(side / contract.detection.working_scales[0]) for side in size)
        pixels = np.clip(grainy(height, width, contract.input.channels, 0), 0, 255).astype(np.uint8)
        image = pixels[..., 0] if contract.input.channels == 1 else pixels
        try:
            elf.detect(image)
        except ElfError as error:
            raise ExportError(
                f"the runtime refuses the finished file on an image of {width}x{height} pixels: {first_line(error)}.  "
                "No file was written; choose another layer"
            ) from error
