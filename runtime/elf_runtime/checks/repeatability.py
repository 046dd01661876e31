"""The paper's two metrics: repeatability and matching score (section 4.1 there)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .greedy import Pairs, greedy_matching

Float = npt.NDArray[np.float64]
Size = tuple[int, int]  # (width, height)
Warp = Callable[[Float], Float]


@dataclass(frozen=True)
class Covisible:
    """The keypoints of a pair that both images see, and how far apart they lie.

    Attributes
    ----------
    first, second : (n1,), (n2,) int64
        Indices into the two images' keypoints.
    distance : (n1, n2) float64
        Pixels in the second image between a warped keypoint of the first and a keypoint of the second.
    """

    first: npt.NDArray[np.int64]
    second: npt.NDArray[np.int64]
    distance: Float


def covisible(
    points1: npt.ArrayLike, points2: npt.ArrayLike, forward: Warp, backward: Warp, size1: Size, size2: Size
) -> Covisible:
    """Drop the keypoints of both images that fall outside the other image after warping.

    Parameters
    ----------
    points1, points2 : (N1, 2), (N2, 2)
        (x, y), integer = pixel centre.
    forward, backward : callables (N, 2) -> (N, 2)
        Ground truth from image 1 to 2 and back; NaN where a point has no image.
    size1, size2 : (width, height)
    """
    p1 = np.asarray(points1, np.float64).reshape(-1, 2)
    p2 = np.asarray(points2, np.float64).reshape(-1, 2)
    warped = forward(p1)
    first = np.flatnonzero(inside(warped, size2))
    second = np.flatnonzero(inside(backward(p2), size1))
    return Covisible(first, second, pairwise_distance(warped[first], p2[second]))


def repeatability_and_matching_score(
    seen: Covisible, descriptor_distance: Float | None, eps: float
) -> tuple[float, float | None, Pairs]:
    """rep = |M| / min(n1, n2) and ms = |M and Md| / min(n1, n2).

    M is the greedy one-to-one matching on the distance in the image, up to `eps`; Md the same on the distance
    of the descriptors, without a threshold.  n1 and n2 count the covisible keypoints.  Both are 0 where one
    image has no such keypoint: nothing found is nothing repeated.

    Parameters
    ----------
    seen : Covisible
    descriptor_distance : (n1, n2) float64, of the covisible keypoints; None for a detector alone
    eps : float
        Pixels; a pair at exactly this distance counts.

    Returns
    -------
    rep : float in [0, 1]
    ms : float in [0, rep], or None without descriptors
    both : (K, 2) int64
        The pairs in M and Md, as rows and columns of ``seen.distance``; M where there are no descriptors.
    """
    least = min(seen.distance.shape)
    in_place = greedy_matching(seen.distance, eps)
    if descriptor_distance is None:
        return (len(in_place) / least if least else 0.0), None, in_place
    if least == 0:
        return 0.0, 0.0, in_place
    partner = np.full(len(seen.first), -1)
    by_descriptor = greedy_matching(descriptor_distance)
    partner[by_descriptor[:, 0]] = by_descriptor[:, 1]
    both = in_place[partner[in_place[:, 0]] == in_place[:, 1]]
    return len(in_place) / least, len(both) / least, both


def inside(points: Float, size: Size) -> npt.NDArray[np.bool_]:
    """(N,) bool: which of the (N, 2) points fall on a pixel of an image of (width, height); NaN does not."""
    half = 0.5
    low = points >= -half
    high = points < np.asarray(size, np.float64) - half
    return np.asarray((low & high).all(axis=1))


def pairwise_distance(a: Float, b: Float) -> Float:
    """(N, M) Euclidean distances of (N, 2) and (M, 2) points."""
    return np.asarray(np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1]))
