"""Distances from true epipolar lines, against cameras and offsets that are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from loops import greedy

from elf_eval.data.truth import Calibrated, Pose, WorkingTruth
from elf_eval.features import ImageFeatures, LocalFeatures
from elf_eval.metrics.epipolar import EPIPOLAR, epipolar_distances, fundamental_matrix
from elf_eval.metrics.family import FeaturePair
from elf_eval.protocol import Protocol

K1 = np.array([[600.0, 2.0, 320], [0, 580.0, 240], [0, 0, 1]])
K2 = np.array([[450.0, 0, 300], [0, 470.0, 250], [0, 0, 1]])


def turned(degrees, axis):
    """Rodrigues' formula."""
    a, u = math.radians(degrees), np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
    return np.eye(3) + math.sin(a) * cross + (1 - math.cos(a)) * cross @ cross


POSE = Pose(turned(9, (0.2, 1, 0.1)), np.array([-1.0, 0.15, 0.3]), K1, K2)


def projected(world):
    """Pixels of (N, 3) points in both cameras, one after the other."""
    pixels = [], []
    for point in world:
        there = [sum(POSE.rotation[i][j] * point[j] for j in range(3)) + POSE.translation[i] for i in range(3)]
        for camera, x, found in ((K1, point, pixels[0]), (K2, there, pixels[1])):
            u, v, w = (sum(camera[i][j] * x[j] for j in range(3)) for i in range(3))
            found.append([u / w, v / w])
    return np.array(pixels[0]), np.array(pixels[1])


def line_through(a, b):
    """Unit normal (n, c) with n.x + c = 0 on the line through two points."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy)
    return -dy / length, dx / length, (dy * a[0] - dx * a[1]) / length


def true_lines(world):
    """In image 2, the line of each point of image 1: through the images of two points of its ray."""
    lines = []
    for point in world:
        near, far = projected([0.8 * point, 1.7 * point])[1]
        lines.append(line_through(near, far))
    return lines


@pytest.fixture
def world(rng):
    return rng.uniform([-3, -2, 6], [3, 2, 12], (60, 3))


def test_points_moved_off_their_lines_are_that_far_away(world, rng):
    p1, p2 = projected(world)
    offsets = rng.uniform(-5, 5, len(world))
    along = rng.uniform(-30, 30, len(world))
    moved = p2.copy()
    for i, (a, b, _) in enumerate(true_lines(world)):
        moved[i] += offsets[i] * np.array([a, b]) + along[i] * np.array([-b, a])
    found = epipolar_distances(p1, moved, fundamental_matrix(POSE))
    # The other image's distance, from the ray of the moved point: its line there goes through two points of that ray.
    expected = []
    for i, offset in enumerate(offsets):
        ray = POSE.rotation.T @ np.linalg.solve(K2, [*moved[i], 1.0])
        centre = -POSE.rotation.T @ POSE.translation
        near, far = projected([centre + 6.0 * ray, centre + 11.0 * ray])[0]
        a, b, c = line_through(near, far)
        back = a * p1[i][0] + b * p1[i][1] + c
        expected.append(math.sqrt((offset**2 + back**2) / 2.0))
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert epipolar_distances(p1, p2, fundamental_matrix(POSE)) == pytest.approx(0.0, abs=1e-9)


def test_the_distance_is_the_same_from_either_side(world, rng):
    p1, p2 = projected(world)
    p2 = p2 + rng.normal(size=p2.shape)
    there = epipolar_distances(p1, p2, fundamental_matrix(POSE))
    back = Pose(POSE.rotation.T, -POSE.rotation.T @ POSE.translation, K2, K1)
    assert epipolar_distances(p2, p1, fundamental_matrix(back)) == pytest.approx(there, rel=1e-9)


def test_what_is_done_to_the_images_is_done_to_the_lines(world, rng):
    """At half the size all distances are half; the truth comes from the dataset's own kind."""
    p1, p2 = projected(world)
    p2 = p2 + rng.normal(size=p2.shape)
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = POSE.rotation, POSE.translation
    truth = Calibrated(*(tuple(m.ravel().tolist()) for m in (K1, K2, transform)))
    half = np.array([[0.5, 0, -0.25], [0, 0.5, -0.25], [0, 0, 1]])
    full, reduced = (fundamental_matrix(truth.at(m, m).pose) for m in (np.eye(3), half))
    distances = epipolar_distances(p1, p2, full)
    assert epipolar_distances(0.5 * p1 - 0.25, 0.5 * p2 - 0.25, reduced) == pytest.approx(distances / 2)


def measured(p1, p2):
    descriptors = np.eye(len(p1), dtype=np.float32)
    images = [
        ImageFeatures(LocalFeatures.build(p, 1.0, descriptors), (640, 480), np.eye(3), 0.0)
        for p in (p1, p2)
    ]  # fmt: skip
    return EPIPOLAR.measure(FeaturePair(*images, WorkingTruth(pose=POSE), Protocol()))


def test_right_matches_are_counted_and_the_median_is_theirs(world):
    """A sideways camera of K1 twice: lines are rows, so that offsets in y are distances in both images."""
    p1, _ = projected(world[:6])
    sideways = Pose(np.eye(3), np.array([1.0, 0.0, 0.0]), K1, K1)
    offsets = np.array([0.25, -0.5, 0.75, 1.5, -2.5, 40.0])
    p2 = p1 + np.stack([np.full(6, -17.0), offsets], axis=1)
    images = [
        ImageFeatures(LocalFeatures.build(p, 1.0, np.eye(6, dtype=np.float32)), (640, 480), np.eye(3), 0.0)
        for p in (p1, p2)
    ]
    record = EPIPOLAR.measure(FeaturePair(*images, WorkingTruth(pose=sideways), Protocol()))
    assert (record["epi_right@1"], record["epi_right@3"]) == (3, 5)
    assert (record["epi@1"], record["epi@3"]) == (0.5, 5 / 6)
    assert record["epi_median"] == pytest.approx(0.75, abs=1e-4)


def test_no_match_near_its_line_has_no_median():
    far = measured(np.array([[100.0, 100.0]]), np.array([[500.0, 400.0]]))
    none = measured(np.zeros((0, 2)), np.zeros((0, 2)))
    for record in (far, none):
        assert record["epi_median"] is None
        assert record["epi_right@3"] == record["epi@3"] == 0


def test_the_matching_score_by_lines_is_that_of_plain_loops(world, rng):
    p1, p2 = projected(world)
    p1, p2 = (np.asarray(p, np.float32) for p in (p1[:40], p2[:30] + rng.normal(0, 4, (30, 2))))
    d1, d2 = rng.normal(size=(40, 3)).astype(np.float32), rng.normal(size=(30, 3)).astype(np.float32)
    d2[:20] = d1[:20] + 0.05
    images = [
        ImageFeatures(LocalFeatures.build(p, -np.arange(len(p)), d), (640, 480), np.eye(3), 0.0)
        for p, d in ((p1, d1), (p2, d2))
    ]
    truth = WorkingTruth(pose=POSE)
    found = EPIPOLAR.measure(FeaturePair(*images, truth, Protocol(eps=5.0)))["epi_ms"]
    look = [[math.dist([float(v) for v in a], [float(v) for v in b]) for b in d2] for a in d1]
    near = 0
    for i, j in greedy(look):
        (distance,) = epipolar_distances(p1[i : i + 1], p2[j : j + 1], fundamental_matrix(POSE))
        near += distance <= 5.0
    assert found == pytest.approx(near / 30)
    assert 0.2 < found < 0.9
    images[1] = ImageFeatures(LocalFeatures.build(np.zeros((0, 2)), 0.0, np.zeros((0, 3))), (640, 480), np.eye(3), 0.0)
    assert EPIPOLAR.measure(FeaturePair(*images, truth, Protocol()))["epi_ms"] == 0.0
