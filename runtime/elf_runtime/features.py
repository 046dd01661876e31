"""What `detect` returns."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from .errors import ElfError

Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Features:
    """Keypoints of one image with scores and descriptors.

    Attributes
    ----------
    keypoints : (N, 2) float32
        (x, y) in pixels of the source image; integer = pixel centre, as in OpenCV.
    scores : (N,) float32
        Descending; ties in raster order.  The denoised saliency, on a scale where 255 is the quantile of it that
        `DetectionParams.normalize` names (its maximum with the paper's settings).
    descriptors : (N, D) float32
        Rows of unit L2 norm; D = 0 for a model without a descriptor.
    image_size : (height, width)
        Of the source image, in pixels.
    nms_radius : float
        In pixels of the source image: the size that `to_cv2` gives a keypoint.
    """

    keypoints: Array
    scores: Array
    descriptors: Array
    image_size: tuple[int, int]
    nms_radius: float = 10.0

    def __len__(self) -> int:
        return len(self.keypoints)

    def to_cv2(self) -> tuple[list[Any], Array]:
        """``(list of cv2.KeyPoint, descriptors)``, as OpenCV's ``detectAndCompute`` returns them.

        A keypoint's ``size`` is the diameter of its suppression window, its ``response`` the score; ELF gives
        no orientation (``angle = -1``).
        """
        size = float(2 * self.nms_radius + 1)
        points = [
            cv2.KeyPoint(float(x), float(y), size, -1.0, float(s))
            for (x, y), s in zip(self.keypoints, self.scores, strict=True)
        ]
        return points, self.descriptors

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a ``.npz`` (keypoints, scores, descriptors, image_size) or ``.csv`` (x,y,score).

        Raises
        ------
        ElfError
            On another ending.
        """
        path = Path(path)
        temporary = path.with_name(f".{path.name}.part")
        if path.suffix == ".npz":
            with open(temporary, "wb") as file:
                np.savez_compressed(
                    file,
                    keypoints=self.keypoints,
                    scores=self.scores,
                    descriptors=self.descriptors,
                    image_size=np.asarray(self.image_size),
                )
        elif path.suffix == ".csv":
            table = np.column_stack([self.keypoints, self.scores])
            np.savetxt(temporary, table, delimiter=",", header="x,y,score", comments="", fmt="%.3f")
        else:
            raise ElfError(f"{path}: features are saved as .npz or .csv")
        os.replace(temporary, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Features:
        """Read a ``.npz`` that `save` wrote.

        Raises
        ------
        ElfError
            If the file is missing or is not such a file.
        """
        try:
            with np.load(path, allow_pickle=False) as data:
                height, width = (int(v) for v in data["image_size"])
                return cls(data["keypoints"], data["scores"], data["descriptors"], (height, width))
        except (OSError, KeyError, ValueError) as error:
            raise ElfError(f"{path}: not a feature file: {error}") from error
