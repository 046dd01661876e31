"""Depth of an image from cameras alone: a sweep of planes, Collins, "A space-sweep approach to true multi-image
matching", CVPR 1996, with normalised cross-correlation.

Planes parallel to the image, equally apart in inverse depth, map each neighbour onto the image by a homography,
x_n ~ K_n (R + t e3^T / z) K^-1 x.  At each pixel the depth is kept whose windows agree best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from elf_eval.coordinates import Float

FloatMap = npt.NDArray[np.float32]

WINDOW = 7  # pixels
PLANES = 128
LEAST = 0.5  # correlation that a depth must reach
_TEXTURE = 2.0  # least standard deviation of a window's grey levels


@dataclass(frozen=True)
class Neighbour:
    """Another image of the same scene.

    Attributes
    ----------
    grey : (h, w) float32
    camera : (3, 3)
        Its intrinsics, in pixels of `grey`.
    rotation, translation : (3, 3), (3,)
        From the coordinates of the image's camera to its own.
    """

    grey: FloatMap
    camera: Float
    rotation: Float
    translation: Float


def sweep(
    grey: FloatMap,
    camera: Float,
    neighbours: Sequence[Neighbour],
    nearest: float,
    farthest: float,
    planes: int = PLANES,
) -> FloatMap:
    """(h, w) depth along the optical axis, 0 where it is not known.

    Parameters
    ----------
    grey : (h, w) float32
    camera : (3, 3)
    neighbours : sequence of Neighbour
        A depth's score is the mean of its two best correlations, so that a pixel may be hidden from the others.
    nearest, farthest : float
        Between which depths to look, in the unit of the translations.
    """
    inverse = np.linspace(1.0 / farthest, 1.0 / nearest, planes)
    scores = np.stack([_score(grey, camera, neighbours, value) for value in inverse])
    best = scores.argmax(axis=0)
    top = np.take_along_axis(scores, best[None], axis=0)[0]
    # The maximum of the parabola through a score and the two beside it; at the ends, the plane itself.
    inner = np.clip(best, 1, planes - 2)
    left, middle, right = (np.take_along_axis(scores, (inner + d)[None], axis=0)[0] for d in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    offset = np.where(bend < -1e-6, 0.5 * (left - right) / np.minimum(bend, -1e-6), 0.0)
    place = np.where(best == inner, inner + np.clip(offset, -0.5, 0.5), best)
    depth = 1.0 / (inverse[0] + place * (inverse[1] - inverse[0]))
    known = (top >= LEAST) & (best > 0) & (best < planes - 1)
    return np.where(known, depth, 0.0).astype(np.float32)


def _score(grey: FloatMap, camera: Float, neighbours: Sequence[Neighbour], inverse: float) -> FloatMap:
    each = np.stack([_correlation(grey, _warped(grey, camera, other, inverse)) for other in neighbours])
    if len(each) > 2:
        each = np.partition(each, len(each) - 2, axis=0)[-2:]
    return np.asarray(each.mean(axis=0), np.float32)


def _warped(grey: FloatMap, camera: Float, other: Neighbour, inverse: float) -> FloatMap:
    """The neighbour as the image would see it were everything on one plane; NaN outside."""
    plane = other.rotation + np.outer(other.translation, (0.0, 0.0, inverse))
    homography = other.camera @ plane @ np.linalg.inv(camera)
    height, width = grey.shape
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = cv2.warpPerspective(
        other.grey, homography, (width, height), flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")
    )
    return np.asarray(seen, np.float32)


def _correlation(a: FloatMap, b: FloatMap) -> FloatMap:
    """Normalised cross-correlation of windows; -1 where one is flat or reaches out of the other image."""
    outside = np.isnan(b)
    b = np.where(outside, np.float32(0.0), b)
    mean_a, mean_b = _box(a), _box(b)
    variance_a, variance_b = _box(a * a) - mean_a**2, _box(b * b) - mean_b**2
    least = _TEXTURE**2
    product = np.sqrt(np.maximum(variance_a, least) * np.maximum(variance_b, least))
    found = (_box(a * b) - mean_a * mean_b) / product
    bad = (variance_a < least) | (variance_b < least) | (_box(outside.astype(np.float32)) > 0.0)
    return np.where(bad, np.float32(-1.0), found).astype(np.float32)


def _box(values: FloatMap) -> FloatMap:
    return np.asarray(cv2.blur(values, (WINDOW, WINDOW), borderType=cv2.BORDER_REFLECT), np.float32)


def agreeing(
    depth: FloatMap, camera: Float, others: Sequence[tuple[FloatMap, Neighbour]], within: float
) -> tuple[npt.NDArray[np.bool_], FloatMap]:
    """Where a neighbour's own depth map agrees to a share `within`, and the least difference as a share, inf if none.

    Parameters
    ----------
    others : sequence of (depth map, neighbour)
    """
    height, width = depth.shape
    rows, columns = np.nonzero(depth > 0)
    z = depth[rows, columns].astype(np.float64)
    rays = np.stack([columns, rows, np.ones(len(rows))]) * 1.0
    points = np.linalg.inv(camera) @ rays * z
    least = np.full(len(rows), np.inf)
    for other, view in others:
        there = view.rotation @ points + view.translation[:, None]
        front = there[2] > 0
        x, y, w = view.camera @ np.where(front, there, 1.0)
        column, row = np.rint(x / w).astype(np.int64), np.rint(y / w).astype(np.int64)
        inside = front & (column >= 0) & (row >= 0) & (column < other.shape[1]) & (row < other.shape[0])
        seen = np.zeros(len(rows))
        seen[inside] = other[row[inside], column[inside]]
        difference = np.where(seen > 0, np.abs(seen - there[2]) / np.maximum(there[2], 1e-12), np.inf)
        least = np.minimum(least, difference)
    result = np.full((height, width), np.inf, np.float32)
    result[rows, columns] = least
    return result <= within, result
