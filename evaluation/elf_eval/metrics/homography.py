"""How well the matches recover the homography."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from elf_eval.coordinates import Float, Size, corners, warp
from elf_eval.protocol import Ransac

from .auc import auc
from .family import FeaturePair, MetricFamily, Record, finite

HOMOGRAPHY_THRESHOLDS = (1, 3, 5)  # pixels


def estimate_homography(p1: Float, p2: Float, ransac: Ransac) -> tuple[Float | None, npt.NDArray[np.bool_]]:
    """The homography between matched (K, 2) points, and which of them are its inliers.

    Returns
    -------
    matrix : (3, 3) with [2, 2] = 1, or None where there are fewer than four matches or none was found
    inliers : (K,) bool
    """
    nothing = np.zeros(len(p1), np.bool_)
    if len(p1) < 4:
        return None, nothing
    cv2.setRNGSeed(ransac.seed)
    matrix, mask = cv2.findHomography(
        p1, p2, ransac.method, ransac.threshold, maxIters=ransac.iterations, confidence=ransac.confidence
    )
    if matrix is None or matrix.size == 0 or not np.isfinite(matrix).all():
        return None, nothing
    return np.asarray(matrix, np.float64), np.asarray(mask, np.bool_).ravel()


def corner_error(estimated: Float | None, truth: Float, size: Size) -> float:
    """Mean distance, in pixels of image 2, of image 1's four corners warped by both homographies.

    Infinite where there is no estimate, or where it sends a corner behind the horizon.
    """
    if estimated is None:
        return float("inf")
    where = corners(size)
    error = float(np.linalg.norm(warp(estimated, where) - warp(truth, where), axis=1).mean())
    return error if np.isfinite(error) else float("inf")


def _measure(pair: FeaturePair) -> Record:
    assert pair.truth.homography is not None
    matrix, inliers = estimate_homography(*pair.matched_points, pair.protocol.homography)
    error = corner_error(matrix, pair.truth.homography, pair.first.size)
    areas = {f"h_auc@{t}": auc(error, t) for t in HOMOGRAPHY_THRESHOLDS}
    return {"h_error": finite(error), "h_inliers": int(inliers.sum()), **areas}


HOMOGRAPHY = MetricFamily(
    _measure,
    counts=("h_inliers",),
    shares=tuple(f"h_auc@{t}" for t in HOMOGRAPHY_THRESHOLDS),
    error="h_error",
    truth="homography",
    descriptors=True,
)
