"""Local features: what a method finds in one image."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .coordinates import Float, Size
from .errors import EvalError

FloatArray = npt.NDArray[np.float32]


@dataclass(frozen=True)
class LocalFeatures:
    """Keypoints of one image, strongest first.

    Attributes
    ----------
    keypoints : (N, 2) float32
        (x, y) in pixels of the image as it was evaluated; an integer is a pixel's centre.
    scores : (N,) float32
        Descending.
    descriptors : (N, D) float32, or (N, bytes) uint8
        Floats are compared by L2 distance, uint8 by Hamming distance.  D = 0: the method only detects.
    sizes : (N,) float32
        Diameters of the keypoints' neighbourhoods in pixels, as in ``cv2.KeyPoint``.
    angles : (N,) float32
        Orientations in degrees, as in ``cv2.KeyPoint``; -1 where the detector gives none.
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
        size, angle = (np.broadcast_to(np.asarray(values, np.float32), n) for values in (sizes, angles))
        return cls(points, score, desc, size, angle).take(np.argsort(-score, kind="stable"))

    def take(self, index: Any) -> LocalFeatures:
        """The features at `index` (integers, a mask or a slice), in that order."""
        return LocalFeatures(*(array[index] for array in vars(self).values()))

    def first(self, count: int) -> LocalFeatures:
        """The `count` strongest."""
        return self.take(slice(count))

    def described(self, descriptors: npt.NDArray[Any]) -> LocalFeatures:
        """The same keypoints with other descriptors."""
        return replace(self, descriptors=descriptors)


@dataclass(frozen=True)
class ImageFeatures:
    """The features of an image, with all that their metrics need of the image itself.

    Attributes
    ----------
    features : LocalFeatures
    size : (width, height)
        Of the working image.
    to_working : (3, 3)
        Pixels of the file -> pixels of the working image.
    seconds : float
        How long the extraction took when it was done, without decoding the image.
    """

    features: LocalFeatures
    size: Size
    to_working: Float
    seconds: float

    def first(self, count: int) -> ImageFeatures:
        """With the `count` strongest features alone."""
        return replace(self, features=self.features.first(count))

    def digest(self) -> str:
        """SHA-256 of all but the time."""
        sha = hashlib.sha256(repr(self.size).encode())
        for array in (*vars(self.features).values(), self.to_working):
            sha.update(f"{array.dtype}{array.shape}".encode())
            sha.update(np.ascontiguousarray(array).tobytes())
        return sha.hexdigest()
