"""From the features of two images to the geometry between them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from elf_runtime.errors import SettingError
from elf_runtime.image.file import ImageLike
from elf_runtime.results.features import Array, Features
from elf_runtime.results.matches import Matches, checked_matches

from .cameras import Cameras
from .fit import Search, fit
from .refine import refine
from .two_view import KINDS, TwoView


def estimate(
    a: Features,
    b: Features,
    kind: str,
    K: Any = None,
    *,
    matches: Matches | None = None,
    ratio: float | None = 0.9,
    images: tuple[ImageLike, ImageLike] | None = None,
    method: str = "accurate",
    threshold: float | None = None,
    confidence: float = 0.9999,
    max_iterations: int = 10_000,
) -> TwoView | None:
    """The geometry between two images, or None where the matches do not support one.

    Supported is what chance would hardly give: as many inliers among as many unrelated matches are expected less than
    0.001 times (`TwoView.chance`).  Images of different scenes give None.  So do inliers that lie on one line in one of
    the images, to within the threshold: they leave the geometry open.

    Parameters
    ----------
    a, b : Features
    kind : "homography", "fundamental" or "essential"
        For a plane or a camera that only turns; for any rigid scene; for one seen by known cameras.  Of a plane alone,
        a fundamental matrix is one of many that fit.
    K : (3, 3), or a pair of such
        Calibration matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] of the camera, in pixels, or the first image's and the
        second's; for an essential matrix.  Images are taken to be free of distortion.
    matches : Matches, optional
        Best first.  By default those of the descriptors that pass Lowe's test at `ratio`.
    ratio : float in (0, 1), optional
        Of `Matches.between`; None keeps all mutual nearest neighbours.
    images : pair of arrays or paths, optional
        The two images, to `refine` the matches by.
    method : "accurate", "prosac", "magsac" or "ransac"
        OpenCV's USAC_ACCURATE, USAC_PROSAC, USAC_MAGSAC or RANSAC.
    threshold : float, optional
        Largest distance of an inlier in pixels, to the point that a homography predicts or to the epipolar line; for an
        essential matrix at the mean focal length.  By default 2 for a homography and 1 for the others.
    confidence : float in (0, 1)
        With which one sample has no wrong match when the search ends.
    max_iterations : int
        Samples at most.

    Returns
    -------
    TwoView or None
        Its `inliers` are about its `indices` and `points`.

    Raises
    ------
    SettingError
        If a setting is unknown or out of range, K is missing or superfluous, or `matches` are of other features.
    ImageError
        As `refine`.
    """
    if kind not in KINDS:
        raise SettingError(f"kind is one of {list(KINDS)}, not {kind!r}")
    if kind != "essential" and K is not None:
        raise SettingError(f"K, the cameras' calibration, goes with the kind 'essential' and not with {kind!r}")
    search = Search(method, threshold, confidence, max_iterations)
    cameras = None if K is None else Cameras.of(K)
    if matches is None:
        matches = Matches.between(a, b, ratio)
    checked_matches(matches)
    if images is not None and not (isinstance(images, (tuple, list)) and len(images) == 2):
        raise SettingError("images is the pair of the first and the second image")
    first, second = matches.points(a, b)
    if images is not None:
        second = refine(matches, a, b, *images)
    view = fit(first, second, kind, search, cameras)
    if not view.supported or any(_on_a_line(side[view.inliers], search.distance(kind)) for side in (first, second)):
        return None
    return replace(view, indices=matches.indices, points=(first, second))


def _on_a_line(points: Array, within: float) -> bool:
    """Whether the root mean square distance of (M, 2) points from the line that fits them best is no more than that."""
    centred = points.astype(np.float64) - points.mean(axis=0, dtype=np.float64)
    across = np.linalg.svd(centred, compute_uv=False)[-1]
    return bool(across <= within * np.sqrt(len(points)))
