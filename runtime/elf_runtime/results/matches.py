"""`Matches`: which features of two images belong together, and how much each such pair is worth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError
from elf_runtime.indices import pairs_of, rows_at

from .features import Array, Features
from .matching import mutual_nearest


@dataclass(frozen=True, eq=False)
class Matches:
    """Matches of two images, best first.  Instances compare by identity.

    Best is the smallest ratio, then the highest similarity, then the lower index of the first image.  This is the order
    that PROSAC draws its samples in: Chum, Matas, "Matching with PROSAC - progressive sample consensus", CVPR 2005.

    Attributes
    ----------
    indices : (K, 2) int64
        Into the features of the first and the second image.
    similarity : (K,) float32
        1 - |a - b|^2 / 2 of the two descriptors: the cosine of rows of unit length, such as ELF's.  Of other rows it
        orders by their distance, too, and may be below -1.
    ratio : (K,) float32
        Distance to the nearest descriptor of the second image over that to the second nearest, in [0, 1].  1 where both
        are 0; 0 where the second image has one descriptor only, as if a second were infinitely far.
    """

    indices: npt.NDArray[np.int64]
    similarity: Array
    ratio: Array

    @classmethod
    def between(
        cls,
        first: Features | npt.NDArray[np.number],
        second: Features | npt.NDArray[np.number],
        ratio: float | None = 0.9,
    ) -> Matches:
        """The pairs that `match` gives for the same arguments, best first, with similarities and ratios.

        Parameters
        ----------
        first, second : Features, or (N, D) and (M, D) descriptors
        ratio : float in (0, 1), optional
            Of Lowe's test, which keeps the matches whose ratio is below it.  0.9 is recommended where a geometry is to
            be estimated; None keeps all mutual nearest neighbours.

        Raises
        ------
        SettingError
            As `match`.
        """
        pairs, squared = mutual_nearest(first, second, ratio, distances=True)
        nearest, next_nearest = squared.T
        quotient = np.divide(nearest, next_nearest, out=np.ones(len(pairs)), where=next_nearest > 0)
        order = np.lexsort((nearest, quotient))  # stable: equal ones stay by the first index
        similarity = np.maximum(1.0 - nearest[order] / 2.0, np.finfo(np.float32).min)
        return cls(pairs[order], similarity.astype(np.float32), np.sqrt(quotient[order]).astype(np.float32))

    @classmethod
    def of(cls, pairs: npt.ArrayLike) -> Matches:
        """Pairs that another matcher found, in its order, which stands for best first; similarity 0 and ratio 1.

        Parameters
        ----------
        pairs : (K, 2) integers
            Indices into the features of the first and the second image.

        Raises
        ------
        SettingError
            If they are something else, or below 0.
        """
        indices = pairs_of(pairs)
        return cls(indices, np.zeros(len(indices), np.float32), np.ones(len(indices), np.float32))

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: Any) -> Matches:
        """The matches at `index`: an integer, a slice, a mask or an array of integers, as of a numpy array."""
        chosen = rows_at(index, len(self))
        return Matches(self.indices[chosen], self.similarity[chosen], self.ratio[chosen])

    def points(self, first: Features, second: Features) -> tuple[Array, Array]:
        """Where they are in the two images, (K, 2) float32 each: (x, y) in pixels, as `Features.keypoints`.

        Raises
        ------
        SettingError
            If these are no Features, or not those of the matches: an index is beyond their number.
        """
        for side in (first, second):
            if not isinstance(side, Features):
                raise SettingError(f"points are of Features, as of ElfRuntime.detect, not of {type(side).__name__}")
        counts = (len(first), len(second))
        if len(self) and ((self.indices < 0) | (self.indices >= counts)).any():
            most = tuple(self.indices.max(axis=0).tolist())
            raise SettingError(f"matches up to {most} are not of these features, {counts[0]} and {counts[1]}")
        return first.keypoints[self.indices[:, 0]], second.keypoints[self.indices[:, 1]]

    def to_cv2(self) -> list[Any]:
        """A list of cv2.DMatch: queryIdx is the first image's, trainIdx the second's, distance |a - b|."""
        distances = np.sqrt(np.maximum(2.0 - 2.0 * self.similarity.astype(np.float64), 0.0))
        return [cv2.DMatch(int(i), int(j), float(d)) for (i, j), d in zip(self.indices, distances, strict=True)]

    def __repr__(self) -> str:
        if not len(self):
            return "Matches(0)"
        return f"Matches({len(self)}, ratio {self.ratio.min():.2f} to {self.ratio.max():.2f})"


def checked_matches(matches: object) -> None:
    """Raise a SettingError where these are no `Matches`."""
    if not isinstance(matches, Matches):
        what = "matches are Matches, as of Matches.of(pairs) or Matches.between(a, b)"
        raise SettingError(f"{what}, not {type(matches).__name__}")
