"""Ground truth between two images of a pair, in pixels of their files, and the same at the working size."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from elf_eval.errors import EvalError, reason
from elf_eval.geometry import Float, warp

Warp = Callable[[Float], Float]


@dataclass(frozen=True)
class Pose:
    """x2 = rotation x1 + translation, in camera coordinates; cameras map those to working pixels."""

    rotation: Float
    translation: Float
    camera1: Float
    camera2: Float


@dataclass(frozen=True)
class WorkingTruth:
    """What is known about a pair at the working size; None is not known.

    Attributes
    ----------
    forward, backward : callables (N, 2) -> (N, 2), together or neither
        Where a keypoint of one image lies in the other; NaN where it has no image there.
    homography : (3, 3)
    pose : Pose
    """

    forward: Warp | None = None
    backward: Warp | None = None
    homography: Float | None = None
    pose: Pose | None = None


class Truth(ABC):
    """Ground truth of a pair."""

    @abstractmethod
    def at(self, to_working1: Float, to_working2: Float) -> WorkingTruth:
        """In working pixels; the arguments lead there from each file's pixels."""

    @abstractmethod
    def known(self) -> tuple[str, ...]:
        """What `at` gives: some of "place" (forward and backward), "homography" and "pose"."""

    @abstractmethod
    def identity(self) -> object:
        """Plain data that the truth depends on, for the results' cache."""


@dataclass(frozen=True)
class Homography(Truth):
    """Of a plane, of a rotating camera or of none at all (the identity).

    Attributes
    ----------
    matrix : nine numbers, row by row, the last one 1
        Pixels of file 1 -> pixels of file 2.
    """

    matrix: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

    def at(self, to_working1: Float, to_working2: Float) -> WorkingTruth:
        matrix = to_working2 @ np.reshape(self.matrix, (3, 3)) @ np.linalg.inv(to_working1)
        inverse = np.linalg.inv(matrix)
        return WorkingTruth(lambda p: warp(matrix, p), lambda p: warp(inverse, p), matrix)

    def known(self) -> tuple[str, ...]:
        return "place", "homography"

    def identity(self) -> object:
        return ["homography", self.matrix]


@dataclass(frozen=True)
class Calibrated(Truth):
    """Two calibrated cameras, with depth maps where there are any.

    Attributes
    ----------
    intrinsics1, intrinsics2 : nine numbers each
        Camera coordinates -> pixels of the file.
    transform : sixteen numbers
        (4, 4), camera coordinates 1 -> camera coordinates 2.
    depth1, depth2 : Path, optional
        ``.npy`` of (H, W), distance along the optical axis in the unit of the translation, 0 = unknown.
    """

    intrinsics1: tuple[float, ...]
    intrinsics2: tuple[float, ...]
    transform: tuple[float, ...]
    depth1: Path | None = None
    depth2: Path | None = None

    def at(self, to_working1: Float, to_working2: Float) -> WorkingTruth:
        k1, k2 = np.reshape(self.intrinsics1, (3, 3)), np.reshape(self.intrinsics2, (3, 3))
        there = np.reshape(self.transform, (4, 4))
        pose = Pose(there[:3, :3], there[:3, 3], to_working1 @ k1, to_working2 @ k2)
        if self.depth1 is None or self.depth2 is None:
            return WorkingTruth(pose=pose)
        depth1, depth2 = read_depth(self.depth1), read_depth(self.depth2)
        back = np.linalg.inv(there)
        file1, file2 = np.linalg.inv(to_working1), np.linalg.inv(to_working2)

        def forward(points: Float) -> Float:
            return warp(to_working2, through_depth(warp(file1, points), depth1, depth2, k1, k2, there))

        def backward(points: Float) -> Float:
            return warp(to_working1, through_depth(warp(file2, points), depth2, depth1, k2, k1, back))

        return WorkingTruth(forward, backward, pose=pose)

    def known(self) -> tuple[str, ...]:
        return ("pose",) if self.depth1 is None or self.depth2 is None else ("place", "pose")

    def identity(self) -> object:
        depths = [str(d) if d else None for d in (self.depth1, self.depth2)]
        return ["calibrated", self.intrinsics1, self.intrinsics2, self.transform, depths]


# A point whose depth differs from the other image's depth map by more than this share lies behind something.
OCCLUSION = 0.05


def through_depth(
    points: Float,
    depth1: npt.NDArray[np.float32],
    depth2: npt.NDArray[np.float32],
    k1: Float,
    k2: Float,
    transform: Float,
) -> Float:
    """Where points of image 1 lie in image 2: x2 ~ K2 (R (z K1^-1 x1) + t).

    Parameters
    ----------
    points : (N, 2)
        Pixels of file 1.

    Returns
    -------
    (N, 2) float64
        Pixels of file 2; NaN where depth 1 is unknown, the point lies behind camera 2, or something stands in
        front of it there (`OCCLUSION`).
    """
    z = _look_up(depth1, points)
    rays = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(k1).T
    there = (rays * z[:, None]) @ transform[:3, :3].T + transform[:3, 3]
    image = warp(k2, there[:, :2] / np.where(there[:, 2:] > 0.0, there[:, 2:], np.nan))
    seen = _look_up(depth2, image)
    hidden = np.abs(seen - there[:, 2]) > OCCLUSION * there[:, 2]
    image[hidden] = np.nan
    return image


def _look_up(depth: npt.NDArray[np.float32], points: Float) -> Float:
    """(N,) depth at the nearest pixel; NaN outside the map or where it is unknown."""
    height, width = depth.shape
    known: npt.NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
    column, row = np.rint(np.where(known[:, None], points, -1.0)).astype(np.int64).T
    within = known & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    z = np.full(len(points), np.nan)
    z[within] = depth[row[within], column[within]]
    return np.where(z > 0.0, z, np.nan)


@lru_cache(maxsize=4)
def read_depth(path: Path) -> npt.NDArray[np.float32]:
    """(H, W) of a ``.npy`` file.

    Raises
    ------
    EvalError
        If there is no such array in it.
    """
    try:
        depth = np.load(path, allow_pickle=False)
    except (OSError, EOFError, ValueError) as error:
        raise EvalError(f"{path}: not a depth map (.npy): {reason(error)}") from error
    if not isinstance(depth, np.ndarray) or depth.dtype.kind not in "fiu" or depth.ndim != 2:
        found = f"{depth.dtype} {depth.shape}" if isinstance(depth, np.ndarray) else "an archive of arrays"
        raise EvalError(f"{path}: a depth map is numbers of shape (H, W), not {found}")
    return np.asarray(depth, np.float32)
