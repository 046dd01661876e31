"""What values a graph's tensors take on photographs, and the schemes to round them by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elf_export.calibration import CalibrationSet
from elf_export.graph.graph import Graph, GraphView
from elf_export.lowering import write_steps
from elf_runtime import InputSpec
from elf_runtime.model.session import open_session

from .scheme import Array, Scheme, fitted

MOST_VALUES = 50_000  # of one tensor of one image


def schemes_for(
    graph: GraphView, names: Sequence[str], images: CalibrationSet, spec: InputSpec, scale: float
) -> dict[str, Scheme]:
    """Schemes for the values `names`, fitted to what they are on the calibration images.

    Parameters
    ----------
    spec : InputSpec
        The graph's input.
    scale : float
        Working scale at which the network will see images.
    """
    wanted = [name for name in names if name not in graph.inputs]
    part = write_steps(Graph(graph.part(wanted), copy=False), "int8").model
    for value in part.graph.output:
        value.type.tensor_type.ClearField("shape")
    session, _ = open_session(part.SerializeToString())
    samples: dict[str, list[Array]] = {name: [] for name in wanted}
    for pixels in images.batches(spec, scale):
        for name, values in zip(wanted, session.run(wanted, {spec.name: pixels}), strict=True):
            samples[name].append(_sample(values))
    return {name: fitted(np.concatenate(parts)) for name, parts in samples.items()}


def _sample(values: Array) -> Array:
    """Some of a tensor's values, evenly spread, and its extremes."""
    flat = values.ravel()
    step = flat.size // MOST_VALUES | 1  # odd: an even step would see the even columns only
    return np.concatenate([flat[::step], [flat.min(initial=0.0), flat.max(initial=0.0)]]).astype(np.float32)
