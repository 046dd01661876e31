"""The image sizes that a finished saliency graph takes, found by running it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import onnx
import onnxruntime as ort

from elf_export.errors import ExportError
from elf_export.graph.image_input import ImageInput
from elf_export.graph.sizes import Sizes
from elf_export.saliency import IMAGE
from elf_runtime import DescriptorSpec
from elf_runtime.model.outputs import check_map

from .free import MULTIPLES, Map, Runner, first_that_holds


class CheckedMaps(Runner):
    """Runs the finished graph on noise, and holds its maps against the geometry that its contract will state."""

    def __init__(self, saliency: onnx.ModelProto, channels: int, descriptors: Sequence[DescriptorSpec]) -> None:
        super().__init__(saliency, ImageInput(IMAGE, "NHWC", channels, (None, None, None)))
        self.descriptors = {spec.output: spec for spec in descriptors}

    def outputs(self, pixels: Map) -> list[Map]:
        values = super().outputs(pixels)
        for output, value in zip(self.session.get_outputs(), values, strict=True):
            if output.name in self.descriptors:
                check_map(value, self.descriptors[output.name], pixels.shape[:3], "the finished graph")
        return values


def sizes_that_run(
    saliency: onnx.ModelProto, sizes: Sizes, channels: int, stride: float, descriptors: Sequence[DescriptorSpec]
) -> Sizes:
    """`sizes`, from the smallest on from which the finished graph runs too, with maps as `descriptors` states them.

    Not all maps scale with the image: those padded to whole windows have cells beyond it, as many on a small image as
    on a large one.
    """
    runner = CheckedMaps(saliency, channels, descriptors)
    reason, larger = "", list[Sizes]()
    multiples = [m for row in MULTIPLES for m in row if m >= sizes.multiple and m % sizes.multiple == 0]
    for multiple in dict.fromkeys([sizes.multiple, *multiples]):
        found = first_that_holds(runner, replace(sizes, multiple=multiple), stride)
        if isinstance(found, Sizes):
            if found.min_size <= 2 * sizes.min_size:
                return found
            larger.append(found)  # another multiple may do with smaller images
        else:
            reason = reason or found
    if larger:
        return min(larger, key=lambda found: found.min_size)
    raise ExportError(f"onnxruntime {ort.__version__} runs the saliency graph at no size that was tried: {reason}")
