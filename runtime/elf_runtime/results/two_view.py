"""Which matches agree with one two-view geometry: a homography or a fundamental matrix, fitted robustly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError

# The fewest matches that the solver behind each model takes.
LEAST_MATCHES = {"homography": 4, "fundamental": 8}
# A geometry is no accident if chance gives fewer than so many like it.
MOST_BY_CHANCE = 1e-3


@dataclass(frozen=True)
class TwoView:
    """A robust fit.

    Attributes
    ----------
    kind : "homography" or "fundamental"
    matrix : (3, 3) float64 or None
        ``x2 ~ H x1``, or ``x2^T F x1 = 0``, of (x, y, 1) in pixels; None where nothing could be fitted.
    inliers : (M,) bool
        Which of the matches agree with `matrix`.
    chance : float
        How many geometries with as many inliers can be expected among as many unrelated matches: see
        `expected_by_chance`.  Infinite where nothing could be fitted.
    """

    kind: str
    matrix: npt.NDArray[np.float64] | None
    inliers: npt.NDArray[np.bool_]
    chance: float = math.inf

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
    kind : "homography" (m = 4, s = 1) or "fundamental" (m = 7, s = 3)
    threshold : float
        t, in pixels.
    size : (height, width)
        Of the image, or of the part of it that has matches.
    """
    sample, solutions = (4, 1) if kind == "homography" else (7, 3)
    if inliers <= sample:
        return math.inf
    area = max(1.0, size[0]) * max(1.0, size[1])
    within = math.pi * threshold**2 if kind == "homography" else 2 * threshold * math.hypot(*size)
    log_p = math.log(min(1.0, within / area))
    logs = math.log(solutions * (matches - sample)) + _log_choose(matches, inliers) + _log_choose(inliers, sample)
    return math.exp(min(700.0, logs + (inliers - sample) * log_p))


def _log_choose(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


def fit(
    first: npt.NDArray[np.float32],
    second: npt.NDArray[np.float32],
    kind: str = "homography",
    threshold: float = 3.0,
) -> TwoView:
    """Fit one geometry to matched points by MAGSAC++; the same input gives the same result.

    Barath, Noskova, Ivashechkin, Matas, "MAGSAC++, a fast, reliable and accurate robust estimator", CVPR
    2020, as OpenCV implements it.

    Parameters
    ----------
    first, second : (M, 2) float32
        Matched points of the two images, in pixels.
    kind : "homography" or "fundamental"
        For a plane or a camera that only turns; for any rigid scene.
    threshold : float
        Largest distance of an inlier, in pixels: to the point that the homography predicts, or to the
        epipolar line.

    Raises
    ------
    SettingError
        If `kind` is unknown, or `threshold` not above 0.
    """
    if kind not in LEAST_MATCHES:
        raise SettingError(f"kind is one of {list(LEAST_MATCHES)}, not {kind!r}")
    if not 0.0 < threshold < float("inf"):
        raise SettingError(f"the inlier threshold is a number of pixels above 0, not {threshold!r}")
    none = TwoView(kind, None, np.zeros(len(first), np.bool_))
    if len(first) < LEAST_MATCHES[kind]:
        return none
    estimate = cv2.findHomography if kind == "homography" else cv2.findFundamentalMat
    try:
        # The USAC estimators draw from a generator of their own with a fixed seed: no need of cv2.setRNGSeed,
        # which would change the caller's random numbers too.
        matrix, inliers = estimate(
            first,
            second,
            method=cv2.USAC_MAGSAC,
            ransacReprojThreshold=threshold,
            maxIters=10_000,
            confidence=0.9999,
        )
    except cv2.error:  # degenerate points, all on one line for example
        return none
    if matrix is None or matrix.shape != (3, 3) or inliers is None:
        return none
    agree = np.asarray(inliers).ravel() != 0
    width, height = np.ptp(second, axis=0).astype(float)
    chance = expected_by_chance(len(second), int(agree.sum()), kind, threshold, (height, width))
    return TwoView(kind, np.asarray(matrix, np.float64), agree, chance)
