"""The homography from matches, and its error."""

from __future__ import annotations

import numpy as np
import pytest

from elf_eval.coordinates import warp
from elf_eval.metrics.homography import corner_error, estimate_homography
from elf_eval.protocol import Ransac

SIZE = (640, 480)


H = np.array([[0.9, 0.1, 30.0], [-0.08, 1.05, 12.0], [1e-4, -5e-5, 1.0]])


@pytest.fixture
def plane(rng):
    p1 = rng.uniform(0, SIZE, (120, 2))
    p2 = warp(H, p1)
    p2[:40] = rng.uniform(0, SIZE, (40, 2))
    return p1, p2


@pytest.mark.parametrize("estimator", ["RANSAC", "USAC_MAGSAC"])
def test_homography_with_a_third_outliers(plane, estimator):
    matrix, inliers = estimate_homography(*plane, Ransac(estimator))
    assert corner_error(matrix, H, SIZE) < 0.01
    assert inliers[40:].all()
    assert inliers[:40].sum() <= 1
    again, _ = estimate_homography(*plane, Ransac(estimator))
    assert np.array_equal(matrix, again)


@pytest.mark.parametrize("count", [0, 3])
def test_too_few_matches_are_an_infinite_error(plane, count):
    matrix, inliers = estimate_homography(plane[0][:count], plane[1][:count], Ransac())
    assert matrix is None
    assert len(inliers) == count
    assert corner_error(matrix, H, SIZE) == np.inf


def test_four_matches_are_enough_for_a_homography():
    square = np.array([[0.0, 0.0], [90.0, 3.0], [80.0, 70.0], [5.0, 60.0]])
    matrix, inliers = estimate_homography(square, square + np.array([10.0, 20.0]), Ransac())
    assert matrix == pytest.approx(np.array([[1, 0, 10], [0, 1, 20], [0, 0, 1]]), abs=1e-6)
    assert inliers.all()


def test_corner_error_is_a_mean_in_pixels():
    shift = np.array([[1.0, 0, 3], [0, 1, 4], [0, 0, 1]])
    assert corner_error(shift @ H, H, SIZE) == pytest.approx(5.0, abs=1e-9)


def test_a_corner_behind_the_horizon_is_an_infinite_error():
    behind = np.array([[1.0, 0, 0], [0, 1, 0], [-0.1, 0, 1]])
    assert corner_error(behind, np.eye(3), (64, 48)) == np.inf
