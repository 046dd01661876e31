"""Anybody's .onnx file as a source; needs onnx, onnxruntime and numpy, no torch."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from elf_export.checks.differences import Differences
from elf_export.detection import changed, chosen
from elf_export.errors import ExportError
from elf_export.file import check_output, default_name
from elf_export.graph.passes import target_opset
from elf_export.preprocessing import Preprocessing
from elf_export.request import LEAST_OPSET, Request, check_precision
from elf_export.sources.describing import check_others, names_another_network
from elf_export.sources.geometry import longest_period, measured_fields
from elf_export.sources.source import Source
from elf_runtime import DetectionParams, WeightsSpec
from elf_runtime.params import setting_text

from .load import load_model
from .prepare import Prepared, prepare


def foreign_detector(request: Request, log: Callable[[str], None]) -> Source:
    """The network in the file `request.onnx`, as a detector.

    Raises
    ------
    ExportError
        A file that can't be read or run, an unknown layer, a working scale for a model of one size, preprocessing for
        another number of channels.
    """
    assert request.onnx is not None
    file = Path(request.onnx)
    detection = chosen(DetectionParams(), request.detection)
    model = load_model(file)
    least_opset = 0 if request.precision == "fp32" else LEAST_OPSET
    check_precision(request.precision, request.opset or max(target_opset(model), least_opset))
    words = request.desc or ()
    own = [word for word in words if not names_another_network(word, model)]
    check_others(request, [word for word in words if word not in own])
    prepared = prepare(model, [request.layer or "", *own], request.input, request.opset, least_opset)
    for note in prepared.notes:
        log(note)
    layer, *resolved = prepared.layers
    called = dict(zip(own, resolved, strict=True))
    _require_scale(prepared, detection)
    output = check_output(request.output or default_name(file.stem, layer), request.force)
    preprocessing = _preprocessing(prepared, request)
    described = list(dict.fromkeys(resolved))
    fields = measured_fields(prepared.model, prepared.image, prepared.sizes, prepared.layers, described)
    complete = replace(
        request,
        layer=layer,
        desc=tuple(dict.fromkeys(called.get(word, word) for word in words)),
        output=output,
        detection=changed(DetectionParams(), detection),
        preprocess=preprocessing,
    )
    return Source(
        request=complete,
        name=file.stem,
        model=prepared.model,
        image=prepared.image,
        layer=layer,
        descriptors=tuple(described),
        preprocessing=preprocessing,
        fields=fields,
        sizes=prepared.sizes,
        period=longest_period(prepared.model, prepared.image, fields, described),
        weights=WeightsSpec(file.name, hashlib.sha256(file.read_bytes()).hexdigest(), ""),
        oracle=Differences(prepared.model, layer, prepared.image, preprocessing),
        detection=detection,
    )


def _require_scale(prepared: Prepared, detection: DetectionParams) -> None:
    fixed = prepared.sizes.width, prepared.sizes.height
    if detection.working_scales != (1.0,) and any(fixed):
        name = "scales" if detection.scales else "scale"
        raise ExportError(
            f"the model takes images of {fixed[0] or 'any'}x{fixed[1] or 'any'} (width x height) only, to which "
            f"the runtime resizes: --set {name}={setting_text(getattr(detection, name))} can't be chosen, leave it out"
        )


def _preprocessing(prepared: Prepared, request: Request) -> Preprocessing:
    channels = prepared.image.channels
    chosen = request.preprocess
    if chosen is not None and not isinstance(chosen, Preprocessing):
        raise ExportError(f"what an .onnx file was trained with is not known: give a Preprocessing, not {chosen!r}")
    if chosen is None:
        return Preprocessing(color="gray" if channels == 1 else "rgb")
    if chosen.channels != channels:
        raise ExportError(
            f"--color {chosen.color} has {chosen.channels} channel(s), the image input {prepared.image.name!r} "
            f"takes {channels}"
        )
    return chosen
