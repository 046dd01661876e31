"""Are the projected descriptor maps the projection of the network's own?"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import onnx

from elf_export.saliency import descriptor_output
from elf_runtime import InputSpec
from elf_runtime.model.session import open_session

from .pictures import probe_images

if TYPE_CHECKING:
    from elf_export.descriptors.projection import Projection

Array = npt.NDArray[np.float32]

Maps = Callable[[Array], Mapping[str, npt.NDArray[np.floating]]]
"""(N, H, W, C) float32 raw pixels -> layer -> (N, h, w, D), before the projection."""

# Whitening enlarges a component's rounding as it does the component: 1e-6 and less without, some 1e-5 of 128 fully
# whitened ones.  A wrong matrix, order of channels or mean is off by about 1.
LARGEST = 1e-3


@dataclass(frozen=True)
class LayerCheck:
    """Agreement of one layer.

    Attributes
    ----------
    error : the largest difference, over the reference's largest absolute value
    """

    layer: str
    source_dim: int
    dim: int
    error: float


@dataclass(frozen=True)
class ProjectionCheck:
    """The projected maps beside the projections of the maps."""

    layers: tuple[LayerCheck, ...]

    @property
    def passed(self) -> bool:
        return all(layer.error <= LARGEST for layer in self.layers)

    @property
    def complaint(self) -> str:
        wrong = ", ".join(repr(layer.layer) for layer in self.layers if not layer.error <= LARGEST)
        return (
            f"the projected descriptors of {wrong} disagree with their reference; at most {LARGEST:g} of the largest "
            "value is wanted."
        )

    def table(self) -> str:
        return "\n".join(
            f"descriptors {c.layer}: {c.source_dim} channels -> {c.dim}, largest error {c.error:.1e} of the largest "
            "value"
            for c in self.layers
        )

    def figures(self) -> dict[str, float]:
        return {"descriptor_error": max(layer.error for layer in self.layers)}


def check_projection(
    model: onnx.ModelProto, maps: Maps, projections: Mapping[str, Projection], spec: InputSpec
) -> ProjectionCheck:
    """Compare the projected outputs in ONNX Runtime with `maps` projected in float64, on an odd-sized batch.

    Parameters
    ----------
    model : onnx.ModelProto
        With the projections inside.
    projections : mapping
        Layer -> Projection.
    """
    session, _ = open_session(model.SerializeToString())
    height, width = spec.size_for(177, 239, 1.0)
    pictures = [picture for _, picture in probe_images(height, width, spec.channels)]
    batch = np.stack(pictures[: spec.batch or len(pictures)])
    wanted = maps(batch)
    found = session.run([descriptor_output(layer) for layer in projections], {spec.name: batch})
    checks = []
    for (layer, projection), values in zip(projections.items(), found, strict=True):
        reference = projection(wanted[layer])
        if values.shape != reference.shape:
            error = np.inf
        else:
            error = float(np.abs(values - reference).max() / max(np.abs(reference).max(), 1e-300))
        checks.append(LayerCheck(layer, len(projection.mean), projection.matrix.shape[1], error))
    return ProjectionCheck(tuple(checks))
