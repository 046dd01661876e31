"""Where the cells of a forward graph's maps lie in the image, held against the sizes that the maps have."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import onnx

from elf_export.errors import LayerError
from elf_export.graph.axes import axes_of
from elf_export.graph.cost import sizes_where_known
from elf_export.graph.graph import GraphView
from elf_export.graph.image_input import ImageInput
from elf_export.graph.receptive_field import WORKING_SIZE, Field, measured, receptive_fields
from elf_export.graph.sizes import Sizes, with_sizes

MEASURED_AT = ((224, 256), (448, 512))  # about so many pixels of height and width
WINDOW = 12  # cells of the largest windows that maps are padded to


def largest_stride(model: onnx.ModelProto, image: ImageInput) -> float:
    """Of all values, in pixels."""
    strides = [field.stride for field in receptive_fields(model, image.name).values()]
    return max((s for s in strides if np.isfinite(s)), default=1.0)


def longest_period(
    model: onnx.ModelProto, image: ImageInput, fields: Mapping[str, Field], descriptors: Sequence[str]
) -> float:
    """Pixels after which the sizes that the network takes, and those of its maps, repeat themselves."""
    cells = WINDOW if any(math.isnan(fields[name].size) for name in descriptors) else 1
    return cells * largest_stride(model, image)


def layer_fields(model: onnx.ModelProto, image: ImageInput, sizes: Sizes, layers: Sequence[str]) -> dict[str, Field]:
    """The geometry of all values, that of maps among `layers` held against the sizes that they have, as `measured`."""
    fields = receptive_fields(model, image.name, sizes.near(*WORKING_SIZE))
    small, large = (sizes.near(*size) for size in MEASURED_AT)
    cells = map_sizes(model, image, small, layers)
    # A walk that the smaller map agrees with is believed: the larger one would cost a run.
    doubted = [name for name in cells if name in fields and measured(fields[name], small, cells[name]) != fields[name]]
    more = map_sizes(model, image, large, doubted) if doubted and large != small else {}
    for name in doubted:
        larger = (large, more[name]) if name in more else None
        fields[name] = measured(fields[name], small, cells[name], larger)
    return fields


def map_sizes(
    model: onnx.ModelProto, image: ImageInput, size: tuple[int, int], layers: Sequence[str]
) -> dict[str, tuple[int, int]]:
    """Height and width of those of `layers` that are maps of more than one cell, for an image of a size."""
    graph = GraphView(with_sizes(model, image, Sizes(*size, 1)))
    sizes = sizes_where_known(graph)
    axes = axes_of(graph, image.name, image.layout, sizes)
    found = {}
    for name in layers:
        cells = dict(zip(axes.get(name, ""), sizes.get(name, ()), strict=False))
        if {"H", "W"} <= cells.keys() and cells["H"] * cells["W"] > 1:
            found[name] = cells["H"], cells["W"]
    return found


def measured_fields(
    model: onnx.ModelProto, image: ImageInput, sizes: Sizes, layers: Sequence[str], descriptors: Sequence[str]
) -> dict[str, Field]:
    """The geometry of all values, that of `layers` held against the sizes of their maps, as `measured` does.

    Raises
    ------
    LayerError
        If the cells of a descriptor's map are not square.
    """
    fields = layer_fields(model, image, sizes, layers)
    height, width = sizes.near(*MEASURED_AT[0])
    for name, (h, w) in map_sizes(model, image, (height, width), descriptors).items():
        across, down = width / w, height / h
        if math.isnan(fields[name].size) and not math.isclose(across, down, rel_tol=0.1):
            raise LayerError(
                f"{name!r} can't describe keypoints: its cells are {across:g}x{down:g} pixels, and must be square"
            )
    return fields
