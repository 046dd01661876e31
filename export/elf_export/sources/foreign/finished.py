"""What is measured of the finished graph: the sizes that it runs on, its maps, and where their cells lie."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime as ort

from elf_export.checks.projection import Maps
from elf_export.errors import ExportError, LayerError
from elf_export.graph.receptive_field import Field
from elf_export.saliency import IMAGE, descriptor_output
from elf_runtime import DescriptorSpec
from elf_runtime.model.outputs import check_map
from elf_runtime.model.session import open_session

from .free_sizes import MULTIPLES, Map, Runner, Sizes, first_that_holds
from .image_input import ImageInput
from .source import MEASURED_AT, Source, largest_stride, layer_fields, map_sizes

WINDOW = 12  # cells of the largest windows that maps are padded to


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


def sizes_of(
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


def maps_of(model: onnx.ModelProto, layers: Sequence[str]) -> Maps:
    """The model's own descriptor maps, by ONNX Runtime."""
    session, _ = open_session(model.SerializeToString())
    outputs = [descriptor_output(layer) for layer in layers]

    def maps(pixels: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[np.float32]]:
        found = session.run(outputs, {session.get_inputs()[0].name: pixels})
        return dict(zip(layers, found, strict=True))

    return maps


def longest_period(source: Source, fields: Mapping[str, Field], descriptors: Sequence[str]) -> float:
    """Pixels after which the sizes that the network takes, and those of its maps, repeat themselves."""
    cells = WINDOW if any(math.isnan(fields[name].size) for name in descriptors) else 1
    return cells * largest_stride(source.model, source.image)


def measured_fields(source: Source, descriptors: Sequence[str]) -> dict[str, Field]:
    """The geometry of all values, that of the layers held against the sizes of their maps, as `measured` does.

    Raises
    ------
    LayerError
        If the cells of a descriptor's map are not square.
    """
    fields = layer_fields(source, source.layers)
    height, width = source.sizes.near(*MEASURED_AT[0])
    for name, (h, w) in map_sizes(source, (height, width), descriptors).items():
        across, down = width / w, height / h
        if math.isnan(fields[name].size) and not math.isclose(across, down, rel_tol=0.1):
            raise LayerError(
                f"{name!r} can't describe keypoints: its cells are {across:g}x{down:g} pixels, and must be square"
            )
    return fields
