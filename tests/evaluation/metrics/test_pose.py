"""The relative pose from matches, and its error."""

from __future__ import annotations

import numpy as np
import pytest

from elf_eval.coordinates import warp
from elf_eval.metrics.pose import estimate_pose, pose_error
from elf_eval.protocol import Ransac

SIZE = (640, 480)


K = np.array([[600.0, 0, 320], [0, 500.0, 240], [0, 0, 1]])


def rotation(degrees):
    a = np.radians(degrees)
    return np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])


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
