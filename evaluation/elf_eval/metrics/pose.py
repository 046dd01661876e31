"""How well the matches recover the relative pose of two calibrated cameras."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from elf_eval.coordinates import Float, warp
from elf_eval.protocol import Ransac

from .auc import auc
from .family import FeaturePair, MetricFamily, Record, finite

POSE_THRESHOLDS = (5, 10, 20)  # degrees
# Of the Image Matching challenge of 2019, whose "mAP" up to 15 degrees is the mean of the shares at 5, 10 and 15.
MAP_THRESHOLDS = (5, 10, 15, 20, 25)


def estimate_pose(
    p1: Float, p2: Float, camera1: Float, camera2: Float, ransac: Ransac
) -> tuple[tuple[Float, Float] | None, npt.NDArray[np.bool_]]:
    """Relative pose from matched points through the essential matrix.

    Parameters
    ----------
    p1, p2 : (K, 2)
        Matched pixels.
    camera1, camera2 : (3, 3)
        From camera coordinates to pixels: the calibration matrix, times what was done to the image since.
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

    Translations are compared as lines, because an essential matrix does not fix the sign.  Where the true one is zero
    (a pure rotation), only the rotation counts.
    """
    if pose is None:
        return float("inf")
    along = direction_angle(pose[1], translation)
    turned = rotation_angle(pose[0], rotation)
    return turned if np.isnan(along) else max(turned, along)


def rotation_angle(a: Float, b: Float) -> float:
    """Angle in degrees between two rotation matrices."""
    cosine = (np.trace(a.T @ b) - 1.0) / 2.0
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def direction_angle(a: Float, b: Float) -> float:
    """Angle in degrees in [0, 90] between two lines of directions `a` and `b`; NaN for a zero vector."""
    norms = float(np.linalg.norm(a) * np.linalg.norm(b))
    if norms == 0.0:
        return float("nan")
    return float(np.degrees(np.arccos(np.clip(abs(float(a @ b)) / norms, 0.0, 1.0))))


def _measure(pair: FeaturePair) -> Record:
    true = pair.truth.pose
    assert true is not None
    pose, inliers = estimate_pose(*pair.matched_points, true.camera1, true.camera2, pair.protocol.pose)
    error = pose_error(pose, true.rotation, true.translation)
    areas = {f"pose_auc@{t}": auc(error, t) for t in POSE_THRESHOLDS}
    below = {f"pose_right@{t}": float(error < t) for t in MAP_THRESHOLDS}
    return {"pose_error": finite(error), "pose_inliers": int(inliers.sum()), **areas, **below}


POSE = MetricFamily(
    _measure,
    counts=("pose_inliers",),
    shares=(
        *(f"pose_auc@{t}" for t in POSE_THRESHOLDS),
        *(f"pose_right@{t}" for t in MAP_THRESHOLDS),
    ),
    error="pose_error",
    truth="pose",
    descriptors=True,
)
