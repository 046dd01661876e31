"""From anyone's .onnx file to a verified ELF model; needs onnx, onnxruntime and numpy, no torch."""

from __future__ import annotations

import hashlib
import math
import os
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnx

from elf_export import differences
from elf_export.axes import axes_of
from elf_export.calibration import calibration_set
from elf_export.cost import sizes_where_known
from elf_export.detection import Wanted, chosen
from elf_export.detection import arguments as detection_arguments
from elf_export.errors import ExportError, LayerError
from elf_export.graph import Graph
from elf_export.output import (
    ExportResult,
    check_opset,
    check_output,
    cost_of,
    descriptor_specs,
    first_that_runs,
    versions,
    write,
)
from elf_export.passes import convert_opset, cut, opset_of, single_precision, target_opset
from elf_export.precision import check_precision, lower
from elf_export.preprocessing import Preprocessing
from elf_export.projection import Reduction
from elf_export.receptive_field import Field, measured, receptive_fields, stated
from elf_export.reduce import arguments as reduction_arguments
from elf_export.reduce import reduce_descriptors
from elf_export.saliency import build_gradient, build_saliency, descriptor_output
from elf_export.verify_projection import MapCheck, Maps
from elf_export.verify_projection import parity as map_parity
from elf_runtime import DetectionParams, InputSpec, ModelContract, WeightsSpec
from elf_runtime.contract import ReductionSpec
from elf_runtime.session import open_session

from .free_sizes import LEAST, Sizes, free_sizes, with_sizes
from .image_input import ImageInput, find_image_input
from .layers import resolve_layer
from .load import load_model


@dataclass(frozen=True)
class Source:
    """A foreign model, ready to be differentiated.

    Attributes
    ----------
    model : onnx.ModelProto
        Cut at the layers, in float32, of an opset that the rules know, its sizes freed.
    """

    model: onnx.ModelProto
    image: ImageInput
    sizes: Sizes
    layers: tuple[str, ...]


def prepare(
    model: onnx.ModelProto, layers: Sequence[str], image_input: str | None = None, opset: int | None = None
) -> Source:
    """Find the image and the layers, cut, convert, and free the sizes.

    Parameters
    ----------
    layers : names
        Of values or nodes, or unique ends of them.

    Raises
    ------
    ExportError
        From `find_image_input`, `resolve_layer`, `convert_opset` or `free_sizes`.
    """
    image = find_image_input(model, image_input)
    names = tuple(resolve_layer(model, layer) for layer in layers)
    trunk = cut(model, list(dict.fromkeys(names)))
    inputs = [value.name for value in trunk.graph.input]
    if image.name not in inputs:
        raise LayerError(f"{', '.join(map(repr, names))} does not depend on the image {image.name!r}")
    if inputs != [image.name]:
        others = ", ".join(repr(name) for name in inputs if name != image.name)
        raise LayerError(
            f"the layer needs more inputs than the image: {others}; choose one before they come in"
        )
    trunk = convert_opset(single_precision(trunk, [image.name]), opset)
    trunk, sizes = free_sizes(trunk, image)
    return Source(trunk, image, sizes, names)


def export_onnx(
    file: str | os.PathLike[str],
    layer: str,
    descriptors: Sequence[str],
    output: str | os.PathLike[str] | None = None,
    *,
    image_input: str | None = None,
    preprocessing: Preprocessing | None = None,
    opset: int | None = None,
    force: bool = False,
    detection: Wanted = None,
    reduction: Reduction | None = None,
    calibration: str | os.PathLike[str] | None = None,
    precision: str = "fp32",
    log: Callable[[str], None] = lambda _: None,
) -> ExportResult:
    """Export any CNN's .onnx file as an ELF model.

    Parameters
    ----------
    layer, descriptors : names
        Of values or nodes, or unique ends of them; no descriptors make a detector.
    output : path, optional
        ``elf-FILE-LAYER.onnx`` by default.
    image_input : str, optional
        Name of the image input, where several may be one.
    preprocessing : Preprocessing, optional
        By default the paper's standardisation, on RGB (or gray) pixels.
    opset : int, optional
        The file's own by default, moved into 11 to 20.
    detection, reduction, calibration, precision : optional
        As in `elf_export.export_network`.

    Returns
    -------
    ExportResult

    Raises
    ------
    ExportError
        A file that can't be read or run, an unknown layer, a working scale for a model of one size, a calibration
        image that can't be used, an op without an adjoint, or a gradient that does not agree with central
        differences; no file is left behind.
    """
    if opset is not None:
        check_opset(opset)
    params = chosen(DetectionParams(), detection)
    images = calibration_set(calibration)
    model = load_model(file)
    check_precision(precision, target_opset(model, opset))
    source = prepare(model, [layer, *descriptors], image_input, opset)
    fixed = source.sizes.width, source.sizes.height
    if params.scale != 1.0 and any(fixed):
        raise ExportError(
            f"the model takes images of {fixed[0] or 'any'}x{fixed[1] or 'any'} (width x height) only, to which the "
            f"runtime resizes: --set scale={params.scale:g} can't be chosen, leave it out"
        )
    name, *described = source.layers
    described = list(dict.fromkeys(described))
    path = check_output(output or f"elf-{Path(file).stem}-{file_name(name)}.onnx", force)
    settings = preprocessing or Preprocessing(color="gray" if source.image.channels == 1 else "rgb")
    if settings.channels != source.image.channels:
        raise ExportError(
            f"--color {settings.color} has {settings.channels} channel(s), the image input {source.image.name!r} "
            f"takes {source.image.channels}"
        )
    saliency = build_saliency(
        source.model, name, described, source.image.name, settings, channels_last=precision == "int8",
        min_size=source.sizes.min_size,
    )  # fmt: skip
    source = replace(source, sizes=sizes_of(saliency, source.sizes, settings.channels))
    log(f"image {source.image.name!r}, {source.image.layout}, {source.image.channels} channel(s); sizes: "
        f"{source.sizes.describe()}")  # fmt: skip
    gradient = build_gradient(source.model, name, source.image.name)
    agreement = differences.check(
        cut(source.model, [name]), gradient, saliency, name, source.image, source.sizes, settings
    )
    differences.require(agreement)
    log(differences.table(agreement))

    fields = measured_fields(saliency, source, settings, described)
    arguments = [
        "elf-export",
        "--onnx",
        Path(file).name,
        "--layer",
        name,
        "--desc",
        ",".join(described) or "none",
    ]
    arguments += ["--input", image_input] if image_input else []
    arguments += ["--opset", str(opset)] if opset else []
    arguments += reduction_arguments(reduction)
    arguments += detection_arguments(DetectionParams(), params)
    arguments += ["--precision", precision] if precision != "fp32" else []
    arguments += ["--calibration", os.fspath(calibration)] if calibration is not None else []
    sizes = source.sizes
    spec = InputSpec(
        color=settings.color, channels=settings.channels, min_size=sizes.min_size,
        height=sizes.height, width=sizes.width, batch=sizes.batch, multiple=sizes.multiple,
    )  # fmt: skip
    reductions: dict[str, ReductionSpec] = {}
    map_checks: list[MapCheck] = []
    if reduction is not None:
        maps = maps_of(saliency, described)
        saliency, reductions, map_checks = reduce_descriptors(
            saliency, described, reduction, images, spec, params.scale, maps, log
        )
    contract = ModelContract(
        network=Path(file).stem,
        layer=name,
        stride=fields[name].stride,
        receptive_field=stated(fields[name].size),
        input=spec,
        descriptors=descriptor_specs(saliency, described, fields, reductions),
        detection=params,
        preprocessing=settings.describe(),
        weights=WeightsSpec(Path(file).name, hashlib.sha256(Path(file).read_bytes()).hexdigest(), ""),
        parity=differences.parity(agreement) | map_parity(map_checks),
        cost=cost_of(saliency, described),
        versions=versions(opset_of(saliency)),
        command=shlex.join([*arguments, *settings.arguments()]),
    )
    saliency, contract = lower(saliency, contract, precision, images, log)
    write(saliency, contract, path)
    return ExportResult(path, contract)


def sizes_of(saliency: onnx.ModelProto, sizes: Sizes, channels: int) -> Sizes:
    """`sizes`, from the smallest on that the finished graph runs on too."""
    tried = (replace(sizes, min_size=s) for s in LEAST if s >= sizes.min_size and s % sizes.multiple == 0)
    images = {s.min_size: (s.batch or 1, *s.near(s.min_size, s.min_size), channels) for s in tried}
    return replace(sizes, min_size=first_that_runs(saliency, images))


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
    fields = receptive_fields(source.model, source.image.name)
    height, width = source.sizes.near(224, 256)
    session, _ = open_session(saliency.SerializeToString())
    pixels = np.zeros((1, height, width, settings.channels), np.float32)
    graph = Graph(with_sizes(source.model, source.image, Sizes(height, width, 1)))
    sizes = sizes_where_known(graph)
    axes = axes_of(graph, source.image.name, source.image.layout, sizes)
    for name in source.layers:
        cells = dict(zip(axes.get(name, ""), sizes.get(name, ()), strict=False))
        if {"H", "W"} <= cells.keys() and cells["H"] * cells["W"] > 1:
            fields[name] = measured(fields[name], (height, width), (cells["H"], cells["W"]))
    for name in descriptors:
        h, w = session.run([descriptor_output(name)], {"image": pixels})[0].shape[1:3]
        across, down = width / w, height / h
        fields[name] = measured(fields[name], (height, width), (h, w))
        if math.isnan(fields[name].size) and not math.isclose(across, down, rel_tol=0.1):
            raise LayerError(
                f"{name!r} can't describe keypoints: its cells are {across:g}x{down:g} pixels, and must be square"
            )
    return fields


def file_name(layer: str) -> str:
    """A layer's name as part of a file's."""
    return "".join(c if c.isalnum() or c in "._" else "_" for c in layer).strip("_.") or "layer"
