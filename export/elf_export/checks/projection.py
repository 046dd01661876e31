"""Are the projected descriptor maps the projection of the network's own?"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnx

from elf_export.descriptors.projection import Projection
from elf_export.errors import VerificationError
from elf_export.saliency import descriptor_output
from elf_runtime import InputSpec
from elf_runtime.model.session import open_session

from .autograd import probe_images

Array = npt.NDArray[np.float32]

Maps = Callable[[Array], Mapping[str, npt.NDArray[np.floating]]]
"""(N, H, W, C) float32 raw pixels -> layer -> (N, h, w, D), before the projection."""

# Whitening enlarges a component's rounding as it does the component: 1e-6 and less without, some 1e-5 of 128 fully
# whitened ones.  A wrong matrix, order of channels or mean is off by about 1.
LARGEST = 1e-3


@dataclass(frozen=True)
class MapCheck:
    """Agreement of one layer.

    Attributes
    ----------
    error : the largest difference, over the reference's largest absolute value
    """

    layer: str
    source_dim: int
    dim: int
    error: float


def verify_projection(
    model: onnx.ModelProto, maps: Maps, projections: Mapping[str, Projection], spec: InputSpec
) -> list[MapCheck]:
    """Compare the projected outputs in ONNX Runtime with `maps` projected in float64, on an odd-sized batch.

    Parameters
    ----------
    model : onnx.ModelProto
        With the projections inside.
    projections : mapping
        Layer -> Projection.

    Raises
    ------
    VerificationError
        If a layer's error is above 1e-3.
    """
    session, _ = open_session(model.SerializeToString())
    height, width = spec.size_for(177, 239, 1.0)
    images = [image for _, image in probe_images(height, width, spec.channels)]
    batch = np.stack(images[: spec.batch or len(images)])
    wanted = maps(batch)
    found = session.run([descriptor_output(layer) for layer in projections], {spec.name: batch})
    checks = []
    for (layer, projection), values in zip(projections.items(), found, strict=True):
        reference = projection(wanted[layer])
        if values.shape != reference.shape:
            error = np.inf
        else:
            error = float(np.abs(values - reference).max() / max(np.abs(reference).max(), 1e-300))
        checks.append(MapCheck(layer, len(projection.mean), projection.matrix.shape[1], error))
    for check in checks:
        if not check.error <= LARGEST:
            raise VerificationError(
                f"the projected descriptors of {check.layer!r} disagree with their reference: off by {check.error:.1e} "
                f"of the largest value, at most {LARGEST:g} is wanted. No file was written."
            )
    return checks


def parity(checks: Sequence[MapCheck]) -> dict[str, float]:
    """The worst error of the checks, for the contract; nothing without projected layers."""
    return {"descriptor_error": max(check.error for check in checks)} if checks else {}


def table(checks: Sequence[MapCheck]) -> str:
    """The checks as a small text table."""
    return "\n".join(
        f"descriptors {c.layer}: {c.source_dim} channels -> {c.dim}, largest error {c.error:.1e} of the largest value"
        for c in checks
    )
