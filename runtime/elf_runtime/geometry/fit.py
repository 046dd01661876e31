"""One geometry fitted to matched points by OpenCV's robust estimators; the same input gives the same result."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError
from elf_runtime.values import is_int, is_number

from .cameras import Cameras
from .two_view import KINDS, Float, TwoView, expected_by_chance

# Name -> OpenCV's method.  They draw from generators of their own with fixed seeds: no need of cv2.setRNGSeed, which
# would change the caller's random numbers too.
METHODS = {
    "accurate": cv2.USAC_ACCURATE,
    "prosac": cv2.USAC_PROSAC,
    "magsac": cv2.USAC_MAGSAC,
    "ransac": cv2.RANSAC,
}
# The fewest matches that the solver behind each kind takes.
LEAST_MATCHES = {"homography": 4, "fundamental": 8, "essential": 5}
# Largest distance of an inlier, in pixels, where none is given.
THRESHOLDS = {"homography": 2.0, "fundamental": 1.0, "essential": 1.0}


@dataclass(frozen=True)
class Search:
    """How a geometry is sought.

    Attributes
    ----------
    method : "accurate", "prosac", "magsac" or "ransac"
        Local optimisation by graph cuts (Barath, Matas, "Graph-cut RANSAC", CVPR 2018); samples from the best matches
        first, which relies on their order (Chum, Matas, "Matching with PROSAC", CVPR 2005); a threshold that is
        integrated out (Barath et al., "MAGSAC++", CVPR 2020); plain RANSAC.
    threshold : float, optional
        Largest distance of an inlier, in pixels: to the point that the homography predicts, or to the epipolar line.
        By default 2 for a homography and 1 for the others.
    confidence : float in (0, 1)
        With which one sample has no wrong match when the search ends.
    max_iterations : int
        Samples at most.

    Raises
    ------
    SettingError
        If one of them is unknown or out of range.
    """

    method: str = "accurate"
    threshold: float | None = None
    confidence: float = 0.9999
    max_iterations: int = 10_000

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise SettingError(f"method is one of {list(METHODS)}, not {self.method!r}")
        given = self.threshold is not None
        if given and not (is_number(self.threshold) and 0.0 < float(self.threshold or 0) < float("inf")):
            raise SettingError(f"the inlier threshold is a number of pixels above 0, not {self.threshold!r}")
        if not (is_number(self.confidence) and 0.0 < self.confidence < 1.0):
            raise SettingError(f"confidence is a number in (0, 1), not {self.confidence!r}")
        if not (is_int(self.max_iterations) and 1 <= self.max_iterations < 2**31):
            raise SettingError(f"max_iterations is an integer from 1 on, not {self.max_iterations!r}")

    def distance(self, kind: str) -> float:
        """The threshold in pixels for this kind of geometry: the given one, or the default."""
        return THRESHOLDS[kind] if self.threshold is None else float(self.threshold)


def fit(
    first: npt.NDArray[np.float32],
    second: npt.NDArray[np.float32],
    kind: str = "homography",
    search: Search | None = None,
    cameras: Cameras | None = None,
) -> TwoView:
    """Fit one geometry to matched points.

    Parameters
    ----------
    first, second : (M, 2) float32
        Matched points of the two images, in pixels; best first, where the method goes by their order.
    kind : "homography", "fundamental" or "essential"
        For a plane or a camera that only turns; for any rigid scene; for one seen by known cameras.
    search : Search, optional
    cameras : Cameras
        Of an essential matrix.

    Raises
    ------
    SettingError
        If `kind` is unknown, or there are no cameras for an essential matrix.
    """
    if kind not in KINDS:
        raise SettingError(f"kind is one of {list(KINDS)}, not {kind!r}")
    if kind == "essential" and cameras is None:
        raise SettingError("an essential matrix needs K, the cameras' calibration matrices")
    search = search or Search()
    threshold = search.distance(kind)
    none = TwoView(kind, None, np.zeros(len(first), np.bool_))
    if len(first) < LEAST_MATCHES[kind]:
        return none
    try:
        if cameras is not None and kind == "essential":
            found = _essential(first, second, cameras, search, threshold)
        else:
            found = _of_pixels(first, second, kind, search, threshold)
    except cv2.error:  # degenerate points, all on one line for example
        return none
    if found is None or found.matrix is None or found.matrix.shape != (3, 3) or not np.isfinite(found.matrix).all():
        return none
    width, height = np.ptp(second, axis=0).astype(float)
    chance = expected_by_chance(len(second), int(found.inliers.sum()), kind, threshold, (height, width))
    return replace(found, chance=chance)


def _of_pixels(
    first: npt.NDArray[np.float32], second: npt.NDArray[np.float32], kind: str, search: Search, threshold: float
) -> TwoView | None:
    matrix, mask = (cv2.findHomography if kind == "homography" else cv2.findFundamentalMat)(
        first,
        second,
        method=METHODS[search.method],
        ransacReprojThreshold=threshold,
        maxIters=search.max_iterations,
        confidence=search.confidence,
    )
    return None if matrix is None or mask is None else TwoView(kind, _float(matrix), _chosen(mask))


def _essential(
    first: npt.NDArray[np.float32],
    second: npt.NDArray[np.float32],
    cameras: Cameras,
    search: Search,
    threshold: float,
) -> TwoView | None:
    """From both cameras' rays, scaled by the mean focal length: distances are then in pixels."""
    focal = cameras.focal
    one, two = cameras.rays(first, second)
    common = np.diag([focal, focal, 1.0])
    matrix, mask = cv2.findEssentialMat(
        one * focal,
        two * focal,
        common,
        METHODS[search.method],
        search.confidence,
        threshold,
        search.max_iterations,
    )
    if matrix is None or mask is None or matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        return None
    rotation, translation, front = cameras.pose(matrix, one, two, mask)
    return TwoView("essential", _float(matrix), front, rotation=rotation, translation=translation)


def _float(matrix: npt.NDArray[np.floating]) -> Float:
    return np.asarray(matrix, np.float64)


def _chosen(mask: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    return np.asarray(mask, np.bool_).ravel()
