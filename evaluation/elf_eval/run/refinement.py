"""Places of matches, refined by the two images as `elf_runtime.refine` does it, for keypoints of any detector."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from elf_eval.coordinates import Float
from elf_eval.features import ImageFeatures
from elf_eval.metrics import pair
from elf_runtime.checks.greedy import Pairs
from elf_runtime.geometry.refine import refine
from elf_runtime.results.features import Features
from elf_runtime.results.matches import Matches

Pixels = npt.NDArray[np.uint8]

# All that the metrics of a pair whose matches are refined depend on, as `pair.CODE`.
CODE = (
    *(*pair.CODE, "elf_eval.run.refinement", "elf_runtime.geometry", "elf_runtime.image", "elf_runtime.contract"),
    *("elf_runtime.params", "elf_runtime.results.features", "elf_runtime.results.matches"),
    *("elf_runtime.results.matching", "elf_runtime.values"),
)


def as_runtime(found: ImageFeatures) -> Features:
    """Keypoints, scores, sizes and angles as the runtime has them, without the descriptors.

    A size that is not above 0 becomes that of a pixel, a negative angle -1 (none), and others are brought to [0, 360).
    """
    own, (width, height) = found.features, found.size
    sizes = np.where(own.sizes > 0, own.sizes, np.float32(1))
    angles = np.where(own.angles < 0, np.float32(-1), np.mod(own.angles, np.float32(360)))
    none = np.zeros((len(own), 0), np.float32)
    return Features(own.keypoints, own.scores, none, (height, width), 1.0, sizes, angles)


def refined_points(first: ImageFeatures, second: ImageFeatures, images: tuple[Pixels, Pixels], matches: Pairs) -> Float:
    """Where the matched keypoints of the first image are in the second, to a fraction of a pixel.

    Parameters
    ----------
    images : two (H, W, 3) uint8, BGR
        As the features were made from them.
    matches : (K, 2)
        Indices into the features.

    Returns
    -------
    (K, 2) float64
        (x, y) in pixels of the second image.
    """
    return refine(Matches.of(matches), as_runtime(first), as_runtime(second), *images).astype(np.float64)
