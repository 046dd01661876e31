"""From anyone's .onnx file to a verified ELF model; needs onnx, onnxruntime and numpy, no torch."""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from elf_export.calibration import calibration_set
from elf_export.checks import differences
from elf_export.checks.projection import MapCheck
from elf_export.checks.projection import parity as map_parity
from elf_export.checks.trial import require_usable
from elf_export.descriptors.projection import Reduction
from elf_export.descriptors.reduce import arguments as reduction_arguments
from elf_export.descriptors.reduce import reduce_descriptors
from elf_export.detection import Wanted, chosen
from elf_export.detection import arguments as detection_arguments
from elf_export.errors import ExportError
from elf_export.graph.passes import cut, opset_of, target_opset
from elf_export.graph.receptive_field import stated
from elf_export.output import ExportResult, check_opset, check_output, cost_of, descriptor_specs, versions, write
from elf_export.precision.lower import LEAST_OPSET, check_precision, lower
from elf_export.preprocessing import Preprocessing
from elf_export.saliency import build_gradient, build_saliency
from elf_runtime import DetectionParams, InputSpec, ModelContract, WeightsSpec
from elf_runtime.contract import ReductionSpec

from .finished import longest_period, maps_of, measured_fields, sizes_of
from .guard import only_export_errors
from .load import load_model
from .source import prepare

LONGEST = 160  # bytes of the file's and the layer's name in that of the new file


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
        image that can't be used, an op without an adjoint, a gradient that does not agree with central differences, or
        a file that the runtime would refuse; none is left behind.
    """
    with only_export_errors(file):
        file = Path(file)
        if opset is not None:
            check_opset(opset)
        params = chosen(DetectionParams(), detection)
        images = calibration_set(calibration)
        model = load_model(file)
        least_opset = 0 if precision == "fp32" else LEAST_OPSET
        check_precision(precision, opset or max(target_opset(model), least_opset))
        source = prepare(model, [layer, *descriptors], image_input, opset, least_opset)
        for note in source.notes:
            log(note)
        fixed = source.sizes.width, source.sizes.height
        if params.scale != 1.0 and any(fixed):
            raise ExportError(
                f"the model takes images of {fixed[0] or 'any'}x{fixed[1] or 'any'} (width x height) only, to which "
                f"the runtime resizes: --set scale={params.scale:g} can't be chosen, leave it out"
            )
        name, *described = source.layers
        described = list(dict.fromkeys(described))
        path = check_output(output or default_name(file, name), force)
        settings = preprocessing or Preprocessing(color="gray" if source.image.channels == 1 else "rgb")
        if settings.channels != source.image.channels:
            raise ExportError(
                f"--color {settings.color} has {settings.channels} channel(s), the image input {source.image.name!r} "
                f"takes {source.image.channels}"
            )
        saliency = build_saliency(
            source.model, name, described, source.image.name, settings, channels_last=precision == "int8",
            min_size=source.sizes.min_size, size=source.sizes.usual,
        )  # fmt: skip
        fields = measured_fields(source, described)
        source = replace(source, sizes=sizes_of(
            saliency, source.sizes, settings.channels, longest_period(source, fields, described),
            descriptor_specs(saliency, described, fields),
        ))  # fmt: skip
        log(f"image {source.image.name!r}, {source.image.layout}, {source.image.channels} channel(s); sizes: "
            f"{source.sizes.describe()}")  # fmt: skip
        gradient = build_gradient(source.model, name, source.image.name)
        agreement = differences.check(
            cut(source.model, [name]), gradient, saliency, name, source.image, source.sizes, settings
        )
        differences.require(agreement)
        log(differences.table(agreement))

        arguments = [
            "elf-export",
            "--onnx",
            file.name,
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
            network=file.stem,
            layer=name,
            stride=fields[name].stride,
            receptive_field=stated(fields[name].size),
            input=spec,
            descriptors=descriptor_specs(saliency, described, fields, reductions),
            detection=params,
            preprocessing=settings.describe(),
            weights=WeightsSpec(file.name, hashlib.sha256(file.read_bytes()).hexdigest(), ""),
            parity=differences.parity(agreement) | map_parity(map_checks),
            cost=cost_of(saliency, described, sizes.usual),
            versions=versions(opset_of(saliency)),
            command=shlex.join([*arguments, *settings.arguments()]),
        )
        saliency, contract = lower(saliency, contract, precision, images, log)
        require_usable(saliency, contract, sizes)
        write(saliency, contract, path)
        return ExportResult(path, contract)


def default_name(file: Path, layer: str) -> str:
    """``elf-FILE-LAYER.onnx``, of a length that file systems take."""
    name = "".join(c if c.isalnum() or c in "._" else "_" for c in layer).strip("_.") or "layer"
    while len(os.fsencode(name)) > LONGEST // 2:
        name = name[1:]
    stem = file.stem
    while len(os.fsencode(stem)) > LONGEST // 2:
        stem = stem[:-1]
    return f"elf-{stem}-{name.strip('_.')}.onnx"
