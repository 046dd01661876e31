"""Pixel coordinates (x, y): an integer is a pixel's centre, so an image spans [-0.5, width - 0.5)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.checks.repeatability import Float as Float
from elf_runtime.checks.repeatability import Size as Size
from elf_runtime.checks.repeatability import Warp as Warp
from elf_runtime.checks.repeatability import inside as inside


def warp(matrix: npt.NDArray[np.floating], points: Any) -> Float:
    """Apply a homography.

    Parameters
    ----------
    matrix : (3, 3), scaled so that visible points get a positive third coordinate
    points : (N, 2)

    Returns
    -------
    (N, 2) float64
        NaN where the third coordinate is <= 0: the point lies on or behind the horizon.
    """
    p = np.asarray(points, np.float64).reshape(-1, 2)
    q = p @ matrix[:, :2].T + matrix[:, 2]
    w = np.where(q[:, 2:] > 1e-12, q[:, 2:], np.nan)
    return np.asarray(q[:, :2] / w, np.float64)


def resize_matrix(source: Size, target: Size) -> Float:
    """(3, 3): pixel coordinates of the source image -> those of the resized one.

    The outer edges of the two images coincide, as in ``cv2.resize``: x' = (x + 0.5) s - 0.5, not x' = s x.
    """
    sx, sy = target[0] / source[0], target[1] / source[1]
    return np.array([[sx, 0.0, (sx - 1.0) / 2.0], [0.0, sy, (sy - 1.0) / 2.0], [0.0, 0.0, 1.0]])


def corners(size: Size) -> Float:
    """(4, 2): the centres of the corner pixels, clockwise from the top left."""
    w, h = size[0] - 1.0, size[1] - 1.0
    return np.array([[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]])
