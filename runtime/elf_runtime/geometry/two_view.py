"""Which matches agree with one geometry of two views: what is found, and whether chance would give as much."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]

# Of each kind: the matches that fix it, and how many geometries they leave.
MINIMAL = {"homography": (4, 1), "fundamental": (7, 3), "essential": (5, 10)}
KINDS = tuple(MINIMAL)
# A geometry is no accident if chance gives fewer than so many like it.
MOST_BY_CHANCE = 1e-3


@dataclass(frozen=True, eq=False)
class TwoView:
    """A robust fit to matches.  Instances compare by identity.

    Attributes
    ----------
    kind : "homography", "fundamental" or "essential"
    matrix : (3, 3) float64 or None
        ``x2 ~ H x1``, or ``x2^T F x1 = 0``, of (x, y, 1) in pixels, or ``y2^T E y1 = 0`` of rays y = K^-1 (x, y, 1).
        None where nothing could be fitted.
    inliers : (M,) bool
        Which of the matches agree with `matrix`; of an essential matrix, those that are also in front of both cameras.
    chance : float
        How many geometries with as many inliers can be expected among as many unrelated matches: see
        `expected_by_chance`.  Infinite where nothing could be fitted.
    rotation, translation : (3, 3) and (3,) float64, or None
        Of an essential matrix: the relative pose, X2 = rotation X1 + translation in the cameras' coordinates (x to the
        right, y down, z forward).  `translation` has unit length, as the images do not show how long it is.
    indices : (M, 2) int64 or None
        The matches that `inliers` counts, into the features of the two images, best first; from `estimate`.
    points : two (M, 2) float32 arrays or None
        Where the matches are, as they were fitted: (x, y) in pixels, refined if `estimate` was given the images.
    """

    kind: str
    matrix: Float | None
    inliers: npt.NDArray[np.bool_]
    chance: float = math.inf
    rotation: Float | None = None
    translation: Float | None = None
    indices: npt.NDArray[np.int64] | None = None
    points: tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]] | None = None

    @property
    def supported(self) -> bool:
        """Whether the matches support the geometry: chance would hardly give as many inliers."""
        return self.chance <= MOST_BY_CHANCE

    def __repr__(self) -> str:
        found = f"{int(self.inliers.sum())} inliers of {len(self.inliers)} matches"
        return f"TwoView({self.kind}: {found if self.matrix is not None else 'none fitted'})"


def expected_by_chance(matches: int, inliers: int, kind: str, threshold: float, size: tuple[float, float]) -> float:
    """How many geometries with so many inliers unrelated matches give, on average: the number of false alarms.

    Moisan, Stival, "A probabilistic criterion to detect rigid point matches between two images and estimate the
    fundamental matrix", IJCV 2004.  A sample of m matches is fitted exactly; each other match is an inlier with the
    probability p that a point anywhere in the image lies within the threshold t of what the geometry predicts, a point
    (p = pi t^2 / A) or a line (p = 2 t D / A; D, A the diagonal and area of the image).  With n matches, k inliers and
    s geometries for a sample,

        s (n - m) C(n, k) C(k, m) p^(k - m)

    Parameters
    ----------
    matches, inliers : int
        n and k.
    kind : "homography" (m = 4, s = 1), "fundamental" (m = 7, s = 3) or "essential" (m = 5, s = 10)
    threshold : float
        t, in pixels.
    size : (height, width)
        Of the image, or of the part of it that has matches; a side counts as one pixel at least.
    """
    sample, solutions = MINIMAL[kind]
    if inliers <= sample:
        return math.inf
    height, width = max(1.0, size[0]), max(1.0, size[1])
    within = math.pi * threshold**2 if kind == "homography" else 2 * threshold * math.hypot(height, width)
    log_p = math.log(min(1.0, within / (height * width)))
    logs = math.log(solutions * (matches - sample)) + _log_choose(matches, inliers) + _log_choose(inliers, sample)
    return math.exp(min(700.0, logs + (inliers - sample) * log_p))


def _log_choose(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
