"""`--desc-dim`: fit, put into the graph, hold against the reference, record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import onnx

from elf_export.calibration import CalibrationSet
from elf_export.checks import Check, require
from elf_export.checks.projection import Maps, check_projection
from elf_export.errors import LayerError
from elf_export.graph.graph import Graph
from elf_export.graph.passes import project
from elf_export.saliency import descriptor_output
from elf_runtime import InputSpec
from elf_runtime.contract import ReductionSpec

from .projection import Projection, Reduction, fit_layers, specs


def reduce_descriptors(
    model: onnx.ModelProto,
    layers: Sequence[str],
    reduction: Reduction | None,
    images: CalibrationSet,
    spec: InputSpec,
    scale: float,
    maps: Maps,
    log: Callable[[str], None] = lambda _: None,
    projections: Mapping[str, Projection] | None = None,
) -> tuple[onnx.ModelProto, Mapping[str, Projection], dict[str, ReductionSpec], tuple[Check, ...]]:
    """`model` with its descriptor maps projected; as it is where no reduction is asked for.

    Parameters
    ----------
    model : onnx.ModelProto
        With the outputs ``descriptors_NAME`` (N, h, w, D) of `layers`.
    layers : names
        As in the contract.
    images : CalibrationSet
        What to fit to.
    spec : InputSpec
        The graph's input.
    scale : float
        Working scale at which the network will see images.
    maps : function
        The layers' maps by an independent computation.
    projections : mapping, optional
        What was fitted to these layers of another network, such as the same before it was compressed.

    Returns
    -------
    model : onnx.ModelProto
    projections : mapping
        Layer -> its projection.
    reductions : dict
        Layer -> what the contract says of it.
    checks : tuple of Check

    Raises
    ------
    ExportError
        No descriptor layer, one of too few channels, a calibration image that can't be read any more, or a graph that
        does not agree with `maps`.
    """
    if reduction is None:
        return model, {}, {}, ()
    if not layers:
        raise LayerError("there is no descriptor layer whose values could be made fewer")
    if projections is None:
        projections = fit_layers(model, layers, reduction, images, spec, scale)
    model = projected(model, projections, reduction)
    check = check_projection(model, maps, projections, spec)
    require(check, log)
    return model, projections, specs(projections, reduction, images), (check,)


def projected(
    model: onnx.ModelProto, projections: Mapping[str, Projection], reduction: Reduction | None
) -> onnx.ModelProto:
    """A copy of `model` with the projections in it; as it is where no reduction is asked for."""
    if reduction is None:
        return model
    matrices = {descriptor_output(name): (p.matrix, -p.mean @ p.matrix) for name, p in projections.items()}
    return project(Graph(model), matrices, reduction.separate).model
