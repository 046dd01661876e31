"""From what is asked for to a verified .onnx file: the whole way of an export, as docs/how-it-works.md tells it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import onnx

from elf_runtime import ModelContract
from elf_runtime.contract import CompressionSpec, ReductionSpec

from .calibration import CalibrationSet, calibration_set
from .checks import Check, require
from .checks.alone import compare_alone
from .checks.compressed import compare_compressed
from .checks.trial import require_usable
from .compression.compress import compress
from .contract import cost_of, descriptor_specs, input_spec, versions
from .descriptors.other_network import attach
from .descriptors.projection import Projection
from .descriptors.reduce import projected, reduce_descriptors
from .end_to_end.build import Form, end_to_end, require_possible
from .file import stamped, write
from .graph.graph import Graph
from .graph.passes import opset_of, portable_forms, require_opset
from .graph.receptive_field import stated
from .graph.sizes import Sizes
from .lowering import write_steps
from .precision.lower import lower
from .request import Log, Request
from .saliency import build_saliency
from .sources import Sources, open_sources
from .sources.foreign.guard import only_export_errors
from .sources.sizes.finished import sizes_that_run


@dataclass(frozen=True)
class ExportResult:
    """What an export made.

    Attributes
    ----------
    path : Path
    contract : ModelContract
    checks : tuple of Check
        What the graph was held against: a saliency check always, one of the projected descriptors, of the compression
        and of the lower precision where there are any.
    """

    path: Path
    contract: ModelContract
    checks: tuple[Check, ...] = ()


def export(request: Request, log: Log = lambda _: None) -> ExportResult:
    """Make the file that `request` asks for; nothing is written unless every check has passed.

    Raises
    ------
    ExportError
        Saying what is wrong and what to do about it; no file is left behind.
    """
    with only_export_errors(request.onnx) if request.onnx is not None else nullcontext():
        require_opset(request.opset)
        images = calibration_set(request.calibration)
        whole = open_sources(request, log)
        if request.end_to_end is not None:
            require_possible(whole.detector.detection, opset_of(whole.detector.model))
        if request.compression is not None:
            log("compressing by what the convolutions give on the calibration images ...")
        sources, compression = compress(whole, request.compression, images, log)
        reference = finished_graph(whole, images) if compression is not None else None
        graph = finished_graph(sources, images, log, reference)
        log("checking the saliency against gradients in float64 ...")
        saliency = sources.detector.oracle.check(graph.model, sources.color, sources.detector.detection, graph.sizes)
        require(saliency, log)
        contract = contract_of(graph, sources, (saliency, *graph.checks), compression)
        contract, compared = compare(graph, contract, reference, whole, images, log)
        if request.precision != "fp32":
            log(f"making {request.precision} of it ...")
        model, contract, lowered = lower(graph.model, graph.masked, contract, request.precision, images, log)
        model = portable_forms(Graph(model)).model
        require_usable(model, contract, graph.sizes)
        model, contract, alone = with_post_processing(model, contract, request.end_to_end, images, log)
        path = Path(sources.request.output or "")
        write(model, contract, path)
        return ExportResult(path, contract, (saliency, *graph.checks, *compared, *lowered, *alone))


@dataclass(frozen=True)
class Finished:
    """The float32 graph of an export, before its saliency is checked.

    Attributes
    ----------
    model : onnx.ModelProto
    masked : onnx.ModelProto
        The same with its masks in operations of `dialect`, for a lower precision to write.
    sizes : Sizes
        Of images that it takes.
    projections : mapping
        Descriptor layer -> its projection, where one is asked for.
    reductions : mapping
        Descriptor layer -> what the contract says of it.
    checks : tuple of Check
        Of the projected descriptors, if there are any.
    """

    model: onnx.ModelProto
    masked: onnx.ModelProto
    sizes: Sizes
    projections: Mapping[str, Projection]
    reductions: Mapping[str, ReductionSpec]
    checks: tuple[Check, ...]


def finished_graph(
    sources: Sources, images: CalibrationSet, log: Log = lambda _: None, whole: Finished | None = None
) -> Finished:
    """Saliency and descriptors, projected where that is asked for, and the sizes that they take.

    A compressed network's descriptors are projected as those of the `whole` one: they can be matched with each other.
    """
    request = sources.request
    masked = saliency_graph(sources)
    model = write_steps(Graph(masked), request.lowering).model
    sizes = finished_sizes(model, sources, log)
    model, projections, reductions, checks = reduce_descriptors(
        model, sources.descriptors, request.reduction, images, input_spec(sources.color, sizes),
        sources.detector.detection.working_scales[0], sources.maps(model), log,
        None if whole is None else whole.projections,
    )  # fmt: skip
    masked = projected(masked, projections, request.reduction)
    return Finished(model, masked, sizes, projections, reductions, checks)


def saliency_graph(sources: Sources) -> onnx.ModelProto:
    """Forward and adjoint of the detector in one graph, with preprocessing in front, and every descriptor map.

    Its masks are operations of `dialect`.
    """
    detector, request = sources.detector, sources.request
    model = build_saliency(
        detector.model, detector.layer, detector.descriptors, detector.image.name, detector.preprocessing,
        differentiate=detector.differentiate, color=sources.color,
        lowering="int8" if request.precision == "int8" else request.lowering,
        min_size=sources.sizes.min_size, size=sources.sizes.usual, masks=True,
    )  # fmt: skip
    for other in sources.others:
        model = attach(
            model, other.model, other.image, other.name, other.labels, other.preprocessing, sources.color,
            sources.sizes.usual,
        )  # fmt: skip
    return model


def finished_sizes(model: onnx.ModelProto, sources: Sources, log: Log) -> Sizes:
    """The sizes of images that the finished graph takes: those of the forward graphs, held against runs of it."""
    detector = sources.detector
    specs = descriptor_specs(model, sources.descriptors, sources.fields, sources.scales)
    forward = sources.sizes
    channels = input_spec(sources.color, forward).channels
    period = max(source.period for source in (detector, *sources.others))
    sizes = sizes_that_run(model, forward, channels, period, specs)
    if detector.request.onnx is not None:
        image = detector.image
        log(f"image {image.name!r}, {image.layout}, {image.channels} channel(s); sizes: {sizes.describe()}")
    return sizes


def compare(
    graph: Finished, contract: ModelContract, other: Finished | None, whole: Sources, images: CalibrationSet, log: Log
) -> tuple[ModelContract, tuple[Check, ...]]:
    """The contract with what compression has changed of the whole network's graph, `other`, and the check that measured
    it; as it is without compression."""
    if other is None:
        return contract, ()
    log("comparing with the network as it was ...")
    check = compare_compressed(stamped(graph.model, contract), stamped(other.model, contract_of(other, whole)), images)
    require(check, log)
    return replace(contract, parity={**contract.parity, **check.figures()}), (check,)


def with_post_processing(
    model: onnx.ModelProto, contract: ModelContract, form: Form | None, images: CalibrationSet, log: Log
) -> tuple[onnx.ModelProto, ModelContract, tuple[Check, ...]]:
    """The finished model as `end_to_end` makes it, and the check that held it against the runtime; as it is without a
    form."""
    if form is None:
        return model, contract, ()
    whole = end_to_end(model, contract, form)
    log("holding the keypoints of the file alone against the runtime's ...")
    check = compare_alone(whole, stamped(model, contract), form, images)
    require(check, log)
    parity, first = {**contract.parity, **check.figures()}, contract.descriptors[:1]
    return whole, replace(contract, end_to_end=form.spec, descriptors=first, parity=parity), (check,)


def contract_of(
    graph: Finished, sources: Sources, checks: Sequence[Check] = (), compression: CompressionSpec | None = None
) -> ModelContract:
    """All that the file says of itself."""
    detector, field = sources.detector, sources.fields[sources.detector.layer]
    return ModelContract(
        network=detector.name,
        layer=detector.layer,
        stride=field.stride,
        receptive_field=stated(field.size),
        input=input_spec(sources.color, graph.sizes),
        descriptors=descriptor_specs(
            graph.model, sources.descriptors, sources.fields, sources.scales, graph.reductions
        ),
        detection=detector.detection,
        preprocessing=detector.preprocessing.describe(),
        weights=sources.weights,
        pooling="average" if detector.request.pool == "average" else "",
        compression=compression,
        parity={name: value for check in checks for name, value in check.figures().items()},
        cost=cost_of(graph.model, sources.descriptors, graph.sizes.usual),
        versions=versions(opset_of(graph.model)),
        command=shlex.join(sources.request.words()),
    )
