"""Homography and relative pose from matches: exact matches, outliers, too few, repeatable bits."""

from __future__ import annotations

import numpy as np
import pytest

from elf_eval.coordinates import warp
from elf_eval.metrics.homography import corner_error, estimate_homography
from elf_eval.metrics.pose import estimate_pose, pose_error
from elf_eval.protocol import Ransac

SIZE = (640, 480)
H = np.array([[0.9, 0.1, 30.0], [-0.08, 1.05, 12.0], [1e-4, -5e-5, 1.0]])
K = np.array([[600.0, 0, 320], [0, 500.0, 240], [0, 0, 1]])


def rotation(degrees):
    a = np.radians(degrees)
    return np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])


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


def two_views(rng, turn, translation):
    """Pixels of a cloud of points in both cameras."""
    world = rng.uniform([-3, -2, 6], [3, 2, 12], (150, 3))
    there = world @ rotation(turn).T + translation
    return warp(K, world[:, :2] / world[:, 2:]), warp(K, there[:, :2] / there[:, 2:])


def test_pose_with_outliers(rng):
    translation = np.array([1.0, 0.1, -0.2])
    p1, p2 = two_views(rng, 8.0, translation)
    p2[:30] = rng.uniform(0, SIZE, (30, 2))
    pose, inliers = estimate_pose(p1, p2, K, K, Ransac("RANSAC", 1.0, 1000, 0.9999))
    assert pose_error(pose, rotation(8.0), translation) < 0.5
    assert inliers[30:].mean() > 0.95


def test_pose_error_is_the_larger_angle_and_has_no_sign():
    t = np.array([1.0, 0, 0])
    assert pose_error((rotation(3.0), -t), rotation(0.0), t) == pytest.approx(3.0)
    tilted = np.array([np.cos(np.radians(7)), np.sin(np.radians(7)), 0])
    assert pose_error((rotation(3.0), tilted), rotation(0.0), t) == pytest.approx(7.0)
    assert pose_error((rotation(3.0), t), rotation(0.0), np.zeros(3)) == pytest.approx(3.0)
    assert pose_error(None, rotation(0.0), t) == np.inf


def test_too_few_matches_have_no_pose():
    assert estimate_pose(np.zeros((4, 2)), np.zeros((4, 2)), K, K, Ransac())[0] is None


def test_five_matches_are_enough_for_a_pose(rng):
    p1, p2 = two_views(rng, 0.0, np.array([0.5, 0.1, 0.0]))
    pose, inliers = estimate_pose(p1[:5], p2[:5], K, K, Ransac("RANSAC", 1.0, 1000))
    assert pose is not None
    assert inliers.sum() == 5
