"""What a method gives for one image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import EvalError

FloatArray = npt.NDArray[np.float32]


@dataclass(frozen=True)
class LocalFeatures:
    """Keypoints of one image, strongest first.

    Attributes
    ----------
    keypoints : (N, 2) float32
        (x, y) in pixels of the image as evaluated; integer = pixel centre.
    scores : (N,) float32
        Descending.
    descriptors : (N, D) float32, or (N, bytes) uint8
        Compared by L2 distance where float, by Hamming distance where uint8.  D = 0: a detector alone.
    sizes : (N,) float32
        Diameter of the keypoint's neighbourhood in pixels, as in ``cv2.KeyPoint``.
    angles : (N,) float32
        Orientation in degrees, as in ``cv2.KeyPoint``; -1 where the detector gives none.
    """

    keypoints: FloatArray
    scores: FloatArray
    descriptors: npt.NDArray[Any]
    sizes: FloatArray
    angles: FloatArray

    def __len__(self) -> int:
        return len(self.keypoints)

    @classmethod
    def build(
        cls,
        keypoints: Any,
        scores: Any,
        descriptors: Any = None,
        sizes: Any = 12.0,
        angles: Any = -1.0,
    ) -> LocalFeatures:
        """From arrays in any order: sorted by descending score, ties in the order given.

        Raises
        ------
        EvalError
            If the lengths differ or a value is NaN or infinite.
        """
        points = np.asarray(keypoints, np.float32).reshape(-1, 2)
        n = len(points)
        score = np.broadcast_to(np.asarray(scores, np.float32), n)
        desc = np.zeros((n, 0), np.float32) if descriptors is None else np.asarray(descriptors)
        if desc.dtype != np.uint8:
            desc = desc.astype(np.float32, copy=False)
        if desc.ndim != 2 or len(desc) != n:
            raise EvalError(f"{n} keypoints, but descriptors of shape {desc.shape}; expected ({n}, D)")
        for name, values in (("keypoint", points), ("score", score), ("descriptor", desc)):
            if not np.isfinite(values).all():
                raise EvalError(f"a {name} is NaN or infinite")
        order = np.argsort(-score, kind="stable")
        return cls(
            points[order],
            score[order],
            desc[order],
            np.broadcast_to(np.asarray(sizes, np.float32), n)[order],
            np.broadcast_to(np.asarray(angles, np.float32), n)[order],
        )

    def take(self, index: Any) -> LocalFeatures:
        """The features at `index` (integers, a mask or a slice), in that order."""
        return LocalFeatures(
            self.keypoints[index],
            self.scores[index],
            self.descriptors[index],
            self.sizes[index],
            self.angles[index],
        )

    def first(self, count: int | None) -> LocalFeatures:
        """The `count` strongest; all where `count` is None."""
        return self if count is None or count >= len(self) else self.take(slice(count))

    def described(self, descriptors: npt.NDArray[Any]) -> LocalFeatures:
        """The same keypoints with other descriptors."""
        return replace(self, descriptors=descriptors)
