"""All metrics of one pair."""

from __future__ import annotations

import numpy as np

from elf_eval.coordinates import Float, Size, Warp, inside, warp
from elf_eval.data.truth import Truth
from elf_eval.errors import EvalError
from elf_eval.features import ImageFeatures
from elf_eval.protocol import Protocol

from .families import FAMILIES
from .family import FeaturePair, Record, Refinement

# All that the metrics of a pair depend on, beside features and settings; for `fingerprint.code_digest`.
CODE = (
    *sorted({family.measure.__module__ for family in FAMILIES}),
    *(f"elf_eval.metrics.{name}" for name in ("pair", "families", "family", "matching", "auc")),
    *("elf_eval.coordinates", "elf_eval.data.truth", "elf_eval.data.depth", "elf_eval.features"),
    *("elf_runtime.checks.greedy", "elf_runtime.checks.repeatability"),
)


def pair_metrics(
    first: ImageFeatures,
    second: ImageFeatures,
    truth: Truth,
    protocol: Protocol,
    refined: Refinement | None = None,
) -> Record:
    """What can be measured on a pair, by name; what its ground truth or the features don't allow is absent.

    Where the protocol refines matches, `refined` says where their second points are, by which mma, h_..., pose_... and
    epi... but epi_ms are measured.

    ====================  =========================================================================
    n1, n2                keypoints of each image
    seen1, seen2          those that the other image sees
    rep, ms               repeatability and matching score, in [0, 1]
    matches               mutual nearest neighbours of all keypoints, after the ratio test if there is one
    mma@1 ... mma@10      share of the matches within so many pixels
    h_error               mean corner error in pixels; None where no homography was found
    h_auc@1, @3, @5       area under the recall curve of the corner error up to so many pixels
    h_inliers             of the matches
    pose_error            degrees; None where no pose was found
    pose_auc@5, @10, @20  area under the recall curve of the pose error up to so many degrees
    pose_right@5 ... @25  whether the pose error is below so many degrees: their mean over thresholds is the mAP of
                          the Image Matching challenge of 2019
    pose_inliers          of the matches
    epi_right@1, @3       matches within so many pixels of the true epipolar lines (`epipolar_distances`)
    epi@1, @3             their share of the matches
    epi_median            median distance in pixels of those within 3; None where there is none
    epi_ms                matching score with a line in the place of the point (`epipolar_matching_score`)
    ====================  =========================================================================

    Raises
    ------
    EvalError
        If a homography sends no point of image 1 into image 2, or a camera's principal point lies outside its image.
    """
    pair = FeaturePair(first, second, truth.at(first.to_working, second.to_working), protocol, refined)
    _check_truth(pair)
    record: Record = {}
    for family in FAMILIES:
        if family.is_defined(truth.known(), pair.is_described):
            record |= family.measure(pair)
    return record


def rounded(record: Record) -> Record:
    """To six significant digits: what is beyond them is rounding."""
    return {k: v if v is None or isinstance(v, int) else float(f"{v:.6g}") for k, v in record.items()}


def _check_truth(pair: FeaturePair) -> None:
    truth = pair.truth
    if truth.pose is not None:
        _check_camera(truth.pose.camera1, pair.first, "first")
        _check_camera(truth.pose.camera2, pair.second, "second")
    if truth.homography is not None and truth.forward is not None:
        _check_overlap(truth.forward, pair.first.size, pair.second.size)


def _check_overlap(forward: Warp, size1: Size, size2: Size) -> None:
    x, y = np.meshgrid(np.linspace(0, size1[0] - 1, 33), np.linspace(0, size1[1] - 1, 33))
    if not inside(forward(np.stack([x.ravel(), y.ravel()], axis=1)), size2).any():
        raise EvalError("the homography does not fit: it sends no point of the first image into the second")


def _check_camera(camera: Float, image: ImageFeatures, which: str) -> None:
    """Refuse intrinsics of another size than the image's: poses from them mean nothing."""
    centre = camera[:2, 2] / camera[2, 2]
    if not inside(centre[None], image.size)[0]:
        x, y = warp(np.linalg.inv(image.to_working), centre[None])[0]
        raise EvalError(
            f"the {which} camera's principal point ({x:g}, {y:g}) lies outside its image: the intrinsics are of "
            "another size of it; scale them by the image's size"
        )
