"""How close the matches of two calibrated cameras lie to the true epipolar lines."""

from __future__ import annotations

import numpy as np

from elf_eval.coordinates import Float
from elf_eval.data.truth import Pose
from elf_runtime.checks.greedy import greedy_matching

from .family import FeaturePair, MetricFamily, Record

EPIPOLAR_THRESHOLDS = (1, 3)  # pixels
EPIPOLAR_ERROR = "epi_median"
_MEDIAN_WITHIN = 3  # pixels


def fundamental_matrix(pose: Pose) -> Float:
    """F = K2^-T [t]x R K1^-1 of (3, 3), with x2^T F x1 = 0 (Hartley and Zisserman, 2nd edition, section 9.6).

    Zero where the cameras have the same centre: such a pair has no epipolar lines.
    """
    x, y, z = pose.translation
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    essential = cross @ pose.rotation
    return np.asarray(np.linalg.inv(pose.camera2).T @ essential @ np.linalg.inv(pose.camera1))


def epipolar_distances(p1: Float, p2: Float, fundamental: Float) -> Float:
    """The symmetric epipolar distance of each match, as a root mean square in pixels.

    sqrt((d(x2, F x1)^2 + d(x1, F^T x2)^2) / 2), where d is a point's distance to the line in its image: the cost of
    Hartley and Zisserman's equation 11.10 per point.  Of two images of one focal length it is nearly the distance in
    either.

    Parameters
    ----------
    p1, p2 : (K, 2) float64
        Matched pixels.

    Returns
    -------
    (K,) float64
        NaN where a point lies on the epipole, through which all lines go.
    """
    x1, x2 = (np.column_stack([points, np.ones(len(points))]) for points in (p1, p2))
    lines2, lines1 = x1 @ fundamental.T, x2 @ fundamental
    residual = (x2 * lines2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = [(residual / np.hypot(lines[:, 0], lines[:, 1])) ** 2 for lines in (lines1, lines2)]
        return np.asarray(np.sqrt((squared[0] + squared[1]) / 2.0))


def epipolar_matching_score(pair: FeaturePair, fundamental: Float) -> float:
    """The paper's matching score with a line in the place of the point: for pairs without depth.

    |matches of the greedy one-to-one matching of all descriptors, within `eps` px of the true epipolar lines| /
    min(N1, N2).  It is above the score by depth wherever a wrong match lies along its line by chance, and below where
    keypoints are out of the other image's sight, which nobody knows here.
    """
    fewest = min(len(pair.first.features), len(pair.second.features))
    if not fewest:
        return 0.0
    first, second = greedy_matching(pair.descriptor_distance).T
    p1 = pair.first.features.keypoints[first].astype(np.float64)
    p2 = pair.second.features.keypoints[second].astype(np.float64)
    return float((epipolar_distances(p1, p2, fundamental) <= pair.protocol.eps).sum()) / fewest


def _measure(pair: FeaturePair) -> Record:
    assert pair.truth.pose is not None
    if not pair.truth.pose.translation.any():
        return {}
    fundamental = fundamental_matrix(pair.truth.pose)
    distances = epipolar_distances(*pair.matched_points, fundamental)
    right = {t: int((distances <= t).sum()) for t in EPIPOLAR_THRESHOLDS}
    near = distances[distances <= _MEDIAN_WITHIN]
    return {
        **{f"epi_right@{t}": count for t, count in right.items()},
        **{f"epi@{t}": count / max(len(distances), 1) for t, count in right.items()},
        EPIPOLAR_ERROR: float(np.median(near)) if len(near) else None,
        "epi_ms": epipolar_matching_score(pair, fundamental),
    }


EPIPOLAR = MetricFamily(
    _measure,
    counts=tuple(f"epi_right@{t}" for t in EPIPOLAR_THRESHOLDS),
    shares=(*(f"epi@{t}" for t in EPIPOLAR_THRESHOLDS), "epi_ms"),
    error=EPIPOLAR_ERROR,
    truth="pose",
    descriptors=True,
)
