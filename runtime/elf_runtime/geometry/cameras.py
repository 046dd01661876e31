"""Two calibrated cameras: from pixels to rays, and from an essential matrix to their relative pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError, shortened

from .two_view import Float

_FARTHEST = 1e9  # baselines: with OpenCV's 50, what is farther than that counts as behind the cameras


@dataclass(frozen=True, eq=False)
class Cameras:
    """The calibration matrices (3, 3) of the two images' cameras, from rays (x, y, 1) to pixels."""

    first: Float
    second: Float

    @classmethod
    def of(cls, K: Any) -> Cameras:
        """From one calibration matrix for both images, or a pair of them.

        Raises
        ------
        SettingError
            If it is not one (3, 3) matrix or two: upper triangular, focal lengths above 0, 1 at the lower right.
        """
        try:
            matrices = np.asarray(K, np.float64)
        except (TypeError, ValueError):
            matrices = np.zeros(0)
        if matrices.shape == (3, 3):
            matrices = np.stack([matrices, matrices])
        if matrices.shape != (2, 3, 3) or not all(map(_is_calibration, matrices)):
            raise SettingError(
                "K is a calibration matrix [[fx, s, cx], [0, fy, cy], [0, 0, 1]] in pixels, or a pair of them, the "
                f"first image's and the second's; not {shortened(' '.join(repr(K).split()), 100)}"
            )
        return cls(matrices[0], matrices[1])

    @property
    def focal(self) -> float:
        """The mean focal length, in pixels."""
        return float(np.mean([np.sqrt(K[0, 0] * K[1, 1]) for K in (self.first, self.second)]))

    def rays(self, first: npt.NDArray[np.float32], second: npt.NDArray[np.float32]) -> tuple[Float, Float]:
        """The (M, 2) float64 places of (M, 2) pixels of both images, on the plane at distance 1."""
        return _rays(self.first, first), _rays(self.second, second)

    @staticmethod
    def pose(
        essential: Float, one: Float, two: Float, mask: npt.NDArray[np.uint8]
    ) -> tuple[Float, Float, npt.NDArray[np.bool_]]:
        """Of the four poses that an essential matrix leaves, the one that has most points in front of both cameras.

        Parameters
        ----------
        essential : (3, 3)
        one, two : (M, 2) float64, rays
        mask : (M, 1) uint8, not 0 where a match is an inlier

        Returns
        -------
        rotation : (3, 3)
        translation : (3,), of unit length
        front : (M,) bool
            The inliers in front of both cameras.
        """
        _, rotation, translation, front, _ = cv2.recoverPose(
            essential, one, two, np.eye(3), distanceThresh=_FARTHEST, mask=mask.copy()
        )
        return (
            np.asarray(rotation, np.float64),
            np.asarray(translation, np.float64).ravel(),
            np.asarray(front, np.bool_).ravel(),
        )


def _is_calibration(K: Float) -> bool:
    below = K[[1, 2, 2], [0, 0, 1]]
    return bool(np.isfinite(K).all() and not below.any() and K[2, 2] == 1.0 and K[0, 0] > 0 and K[1, 1] > 0)


def _rays(K: Float, points: npt.NDArray[np.float32]) -> Float:
    homogeneous = np.column_stack([points.astype(np.float64), np.ones(len(points))])
    return np.asarray(np.linalg.solve(K, homogeneous.T).T[:, :2])
