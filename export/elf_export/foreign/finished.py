"""What is measured of the finished graph: the sizes that it runs on, its maps, and where their cells lie."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime as ort

from elf_export.errors import ExportError, LayerError
from elf_export.preprocessing import Preprocessing
from elf_export.receptive_field import Field, measured
from elf_export.saliency import IMAGE, descriptor_output
from elf_export.verify_projection import Maps
from elf_runtime.session import open_session

from .free_sizes import MULTIPLES, Runner, Sizes, first_that_holds
from .image_input import ImageInput
from .source import MEASURED_AT, Source, layer_fields


def sizes_of(saliency: onnx.ModelProto, sizes: Sizes, channels: int, stride: float) -> Sizes:
    """`sizes`, from the smallest on from which the finished graph runs too, as `first_that_holds`."""
    runner = Runner(saliency, ImageInput(IMAGE, "NHWC", channels, (None, None, None)))
    reason = ""
    multiples = [m for row in MULTIPLES for m in row if m >= sizes.multiple and m % sizes.multiple == 0]
    for multiple in dict.fromkeys([sizes.multiple, *multiples]):
        found = first_that_holds(runner, replace(sizes, multiple=multiple), stride)
        if isinstance(found, Sizes):
            return found
        reason = reason or found
    raise ExportError(f"onnxruntime {ort.__version__} runs the saliency graph at no size that was tried: {reason}")


def maps_of(model: onnx.ModelProto, layers: Sequence[str]) -> Maps:
    """The model's own descriptor maps, by ONNX Runtime."""
    session, _ = open_session(model.SerializeToString())
    outputs = [descriptor_output(layer) for layer in layers]

    def maps(pixels: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[np.float32]]:
        found = session.run(outputs, {session.get_inputs()[0].name: pixels})
        return dict(zip(layers, found, strict=True))

    return maps


def measured_fields(
    saliency: onnx.ModelProto, source: Source, settings: Preprocessing, descriptors: Sequence[str]
) -> dict[str, Field]:
    """The geometry of all values, that of the layers held against the sizes of their maps, as `measured` does.

    Raises
    ------
    LayerError
        If the cells of a descriptor's map are not square.
    """
    fields = layer_fields(source, source.layers)
    height, width = source.sizes.near(*MEASURED_AT)
    session, _ = open_session(saliency.SerializeToString())
    pixels = np.zeros((1, height, width, settings.channels), np.float32)
    for name in descriptors:
        h, w = session.run([descriptor_output(name)], {"image": pixels})[0].shape[1:3]
        across, down = width / w, height / h
        fields[name] = measured(fields[name], (height, width), (h, w))
        if math.isnan(fields[name].size) and not math.isclose(across, down, rel_tol=0.1):
            raise LayerError(
                f"{name!r} can't describe keypoints: its cells are {across:g}x{down:g} pixels, and must be square"
            )
    return fields
