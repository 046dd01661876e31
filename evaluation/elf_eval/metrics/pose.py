"""How well the matches give back the relative pose of two calibrated cameras."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from elf_eval.geometry import Float, direction_angle, rotation_angle, warp
from elf_eval.protocol import Ransac

POSE_THRESHOLDS = (5, 10, 20)  # degrees


def estimate_pose(
    p1: Float, p2: Float, camera1: Float, camera2: Float, ransac: Ransac
) -> tuple[tuple[Float, Float] | None, npt.NDArray[np.bool_]]:
    """Relative pose from matched points through the essential matrix.

    Parameters
    ----------
    p1, p2 : (K, 2)
        Matched pixels.
    camera1, camera2 : (3, 3)
        From camera coordinates to pixels: the calibration matrix, times whatever was done to the image since.
    ransac : Ransac
        Its threshold is in pixels; it is divided by the cameras' mean focal length.

    Returns
    -------
    pose : (R, t) with x2 = R x1 + t and unit t, or None: fewer than five matches, or none was found
    inliers : (K,) bool
        Inliers of the essential matrix that lie in front of both cameras.
    """
    nothing = np.zeros(len(p1), np.bool_)
    if len(p1) < 5:
        return None, nothing
    rays1 = warp(np.linalg.inv(camera1), p1)
    rays2 = warp(np.linalg.inv(camera2), p2)
    focal = np.mean([np.sqrt(abs(np.linalg.det(camera[:2, :2]))) for camera in (camera1, camera2)])
    cv2.setRNGSeed(ransac.seed)
    essential, mask = cv2.findEssentialMat(
        rays1, rays2, np.eye(3), ransac.method, ransac.confidence, ransac.threshold / focal, ransac.iterations
    )
    if essential is None or essential.size == 0:
        return None, nothing
    best: tuple[Float, Float] | None = None
    inliers, most = nothing, 0
    for candidate in np.split(essential, len(essential) // 3):  # the five-point solver may give several
        count, rotation, direction, front = cv2.recoverPose(candidate, rays1, rays2, np.eye(3), mask=mask.copy())
        if count > most:
            best, inliers, most = (rotation, direction.ravel()), np.asarray(front, np.bool_).ravel(), count
    return best, inliers


def pose_error(pose: tuple[Float, Float] | None, rotation: Float, translation: Float) -> float:
    """The larger of the angular errors of rotation and translation, in degrees; infinite without an estimate.

    The translation is compared as a line, since an essential matrix does not fix its sign; where the true one
    is zero (a pure rotation) only the rotation counts.
    """
    if pose is None:
        return float("inf")
    along = direction_angle(pose[1], translation)
    turned = rotation_angle(pose[0], rotation)
    return turned if np.isnan(along) else max(turned, along)
