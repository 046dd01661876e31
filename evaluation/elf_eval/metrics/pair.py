"""All metrics of one pair."""

from __future__ import annotations

import numpy as np

from elf_eval.data.truth import Truth, Warp, WorkingTruth
from elf_eval.errors import EvalError
from elf_eval.geometry import Float, Size, inside, warp
from elf_eval.protocol import Protocol
from elf_eval.run.cache import Extracted

from . import (
    auc,
    corner_error,
    covisible,
    descriptor_distances,
    estimate_homography,
    estimate_pose,
    mean_matching_accuracy,
    mutual_nearest,
    pose_error,
    repeatability_and_matching_score,
)
from .homography import HOMOGRAPHY_THRESHOLDS
from .matching import MMA_THRESHOLDS
from .pose import POSE_THRESHOLDS

Record = dict[str, float | None]


def pair_metrics(first: Extracted, second: Extracted, truth: Truth, protocol: Protocol) -> Record:
    """What can be measured on a pair, by name; what its ground truth or the features don't allow is absent.

    ====================  =========================================================================
    n1, n2                keypoints of each image
    seen1, seen2          those that the other image sees
    rep, ms               repeatability and matching score, in [0, 1]
    matches               mutual nearest neighbours of all keypoints
    mma@1 ... mma@10      share of the matches within so many pixels
    h_error               mean corner error in pixels; None where no homography was found
    h_auc@1, @3, @5       area under the recall curve of the corner error up to so many pixels
    h_inliers             of the matches
    pose_error            degrees; None where no pose was found
    pose_auc@5, @10, @20  area under the recall curve of the pose error up to so many degrees
    pose_inliers          of the matches
    ====================  =========================================================================

    Raises
    ------
    EvalError
        If a homography sends no point of image 1 into image 2, or a camera's principal point lies outside its image.
    """
    a, b = first.features, second.features
    known = truth.at(first.to_working, second.to_working)
    if known.pose is not None:
        _check_camera(known.pose.camera1, first, "first")
        _check_camera(known.pose.camera2, second, "second")
    described = a.descriptors.shape[1] and b.descriptors.shape[1]  # a (0, D) array is: nothing found
    distance = descriptor_distances(a.descriptors, b.descriptors) if described else None
    record: Record = {"n1": len(a), "n2": len(b)}
    if known.forward is not None and known.backward is not None:
        if known.homography is not None:
            _check_overlap(known.forward, first.size, second.size)
        seen = covisible(a.keypoints, b.keypoints, known.forward, known.backward, first.size, second.size)
        of_seen = None if distance is None else distance[np.ix_(seen.first, seen.second)]
        rep, ms, _ = repeatability_and_matching_score(seen, of_seen, protocol.eps)
        record |= {"seen1": len(seen.first), "seen2": len(seen.second), "rep": rep}
        if ms is not None:
            record["ms"] = ms
    if distance is not None:
        matches = mutual_nearest(distance)
        p1 = a.keypoints[matches[:, 0]].astype(np.float64)
        p2 = b.keypoints[matches[:, 1]].astype(np.float64)
        record["matches"] = len(matches)
        if known.forward is not None:
            accuracy = mean_matching_accuracy(np.linalg.norm(known.forward(p1) - p2, axis=1))
            record |= {f"mma@{t}": value for t, value in zip(MMA_THRESHOLDS, accuracy, strict=True)}
        record |= _estimates(p1, p2, known, first.size, protocol)
    return record


def _estimates(p1: Float, p2: Float, known: WorkingTruth, size: Size, protocol: Protocol) -> Record:
    record: Record = {}
    if known.homography is not None:
        matrix, inliers = estimate_homography(p1, p2, protocol.homography)
        error = corner_error(matrix, known.homography, size)
        record |= {"h_error": _finite(error), "h_inliers": int(inliers.sum())}
        record |= {f"h_auc@{t}": auc(error, t) for t in HOMOGRAPHY_THRESHOLDS}
    if known.pose is not None:
        pose, inliers = estimate_pose(p1, p2, known.pose.camera1, known.pose.camera2, protocol.pose)
        error = pose_error(pose, known.pose.rotation, known.pose.translation)
        record |= {"pose_error": _finite(error), "pose_inliers": int(inliers.sum())}
        record |= {f"pose_auc@{t}": auc(error, t) for t in POSE_THRESHOLDS}
    return record


def _check_overlap(forward: Warp, size1: Size, size2: Size) -> None:
    x, y = np.meshgrid(np.linspace(0, size1[0] - 1, 33), np.linspace(0, size1[1] - 1, 33))
    if not inside(forward(np.stack([x.ravel(), y.ravel()], axis=1)), size2).any():
        raise EvalError("the homography does not fit: it sends no point of the first image into the second")


def _check_camera(camera: Float, image: Extracted, which: str) -> None:
    """Intrinsics of another size than the image's give poses that mean nothing."""
    centre = camera[:2, 2] / camera[2, 2]
    if not inside(centre[None], image.size)[0]:
        x, y = warp(np.linalg.inv(image.to_working), centre[None])[0]
        raise EvalError(
            f"the {which} camera's principal point ({x:g}, {y:g}) lies outside its image: the intrinsics are of "
            "another size of it; scale them by the image's size"
        )


def _finite(error: float) -> float | None:
    return error if np.isfinite(error) else None
