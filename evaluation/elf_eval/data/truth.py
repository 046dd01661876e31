"""Ground truth between the two images of a pair: in pixels of their files, and at the working size."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elf_eval.coordinates import Float, Warp, warp

from .depth import read_depth, through_depth


@dataclass(frozen=True)
class Pose:
    """x2 = rotation x1 + translation in camera coordinates, which camera1 and camera2 map to working pixels."""

    rotation: Float
    translation: Float
    camera1: Float
    camera2: Float


@dataclass(frozen=True)
class WorkingTruth:
    """What is known about a pair at the working size; None where it is not known.

    Attributes
    ----------
    forward, backward : callables (N, 2) -> (N, 2), together or neither
        Where a keypoint of one image lies in the other; NaN where it is not seen there.
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
        """The truth in working pixels.

        Parameters
        ----------
        to_working1, to_working2 : (3, 3)
            Each file's pixels -> its working pixels.
        """

    @abstractmethod
    def known(self) -> tuple[str, ...]:
        """What `at` gives: some of "place" (forward and backward), "homography" and "pose"."""

    @abstractmethod
    def identity(self) -> object:
        """Plain data that the truth depends on: part of what identifies a pair's metrics."""


@dataclass(frozen=True)
class Homography(Truth):
    """Of a plane, or of a camera that turns or does not move at all (the identity).

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
