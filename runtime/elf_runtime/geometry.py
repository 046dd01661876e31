"""Which matches agree with one two-view geometry: a homography or a fundamental matrix, fitted robustly."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from .errors import SettingError

# The fewest matches that the solver behind each model takes.
LEAST_MATCHES = {"homography": 4, "fundamental": 8}


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
    """

    kind: str
    matrix: npt.NDArray[np.float64] | None
    inliers: npt.NDArray[np.bool_]


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
    return TwoView(kind, np.asarray(matrix, np.float64), np.asarray(inliers).ravel() != 0)
