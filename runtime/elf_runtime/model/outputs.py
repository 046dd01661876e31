"""The outputs of a run, held against the contract: a model that breaks it is an error, and gives no keypoints."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec
from elf_runtime.errors import ModelError

Array = npt.NDArray[np.float32]

# How many cells more or fewer than its stride and offset say a map may have, in all and as a share.  Padding and
# rounding at strides differ by one or two, and the geometry of SAME padding changes with the image's size.
_CELLS, _SHARE = 2, 0.1


def check_saliency(saliency: Array, shape: tuple[int, int, int], model: str) -> None:
    """Raise ModelError unless the map is (N, h, w) of the images that the graph was fed, finite and not negative."""
    if saliency.shape != shape:
        raise ModelError(f"{model}: gives a saliency of shape {saliency.shape} for images of shape {shape}")
    if not (saliency.min() >= 0 and saliency.max() < np.inf):  # NaN fails both
        raise ModelError(f"{model}: its saliency has negative, infinite or NaN values on this image")


def check_map(feature_map: Array, spec: DescriptorSpec, shape: tuple[int, int, int], model: str) -> None:
    """Raise ModelError unless the map (N, h, w, D) has the dimension and the cells that the contract says."""
    if feature_map.ndim != 4 or feature_map.shape[0] != shape[0] or feature_map.shape[3] != spec.dim:
        wanted = f"({shape[0]}, h, w, {spec.dim})"
        raise ModelError(f"{model}: the output {spec.output!r} is of shape {feature_map.shape}, not {wanted}")
    for side, cells in zip(shape[1:], feature_map.shape[1:3], strict=True):
        # Cells that tile the image, or, without padding, as many as are left between two margins of the offset.
        expected = side / spec.stride
        least = min(expected, (side - 1 - 2 * spec.offset) / spec.stride + 1)
        near = max(_CELLS, _SHARE * expected)
        if not max(1, least - near) <= cells <= expected + near:
            raise ModelError(
                f"{model}: the output {spec.output!r} has {feature_map.shape[1]}x{feature_map.shape[2]} cells for an "
                f"image of {shape[1]}x{shape[2]} pixels; a cell every {spec.stride:g} pixels from {spec.offset:g} on, "
                f"as 'elf.descriptors' says, would be {expected:.0f} along {side} pixels"
            )


def check_descriptors(rows: Array, feature_map: Array, spec: DescriptorSpec, model: str) -> None:
    """Raise ModelError on NaN or infinite descriptors, and where the whole map is zero."""
    if not np.isfinite(rows).all():
        raise ModelError(f"{model}: the output {spec.output!r} has NaN or infinite values on this image")
    if len(rows) and not rows.any() and not feature_map.any():
        raise ModelError(f"{model}: the output {spec.output!r} is zero everywhere on this image")
