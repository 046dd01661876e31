"""Robust two-view geometry on points whose geometry is known."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from elf_runtime import SettingError
from elf_runtime.geometry.fit import Search, fit
from elf_runtime.geometry.two_view import TwoView, expected_by_chance

HOMOGRAPHY = np.array([[0.9, 0.12, 15.0], [-0.08, 1.05, -9.0], [1e-4, -5e-5, 1.0]])


def planar(count: int, wrong: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and their images under HOMOGRAPHY; the last `wrong` of them go anywhere."""
    rng = np.random.default_rng(0)
    first = rng.uniform(0, 600, (count, 2)).astype(np.float32)
    second = cv2.perspectiveTransform(first[None], HOMOGRAPHY)[0]
    second[count - wrong :] = rng.uniform(0, 600, (wrong, 2))
    return first, second


def rigid(count: int, wrong: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a scene with depth, seen by two cameras."""
    rng = np.random.default_rng(1)
    scene = rng.uniform((-3, -2, 6), (3, 2, 14), (count, 3))
    turn = cv2.Rodrigues(np.array([0.02, 0.1, -0.03]))[0]
    views = []
    for rotation, shift in ((np.eye(3), np.zeros(3)), (turn, np.array([-1.0, 0.1, 0.2]))):
        moved = scene @ rotation.T + shift
        views.append((500 * moved[:, :2] / moved[:, 2:] + 320).astype(np.float32))
    views[1][count - wrong :] = rng.uniform(0, 640, (wrong, 2))
    return views[0], views[1]


def test_finds_the_homography_among_wrong_matches() -> None:
    first, second = planar(100, 40)
    view = fit(first, second, "homography")
    assert view.matrix is not None
    np.testing.assert_allclose(view.matrix / view.matrix[2, 2], HOMOGRAPHY, atol=2e-3, rtol=1e-3)
    assert view.inliers[:60].all()
    assert view.inliers[60:].sum() <= 1


def test_finds_the_fundamental_matrix_among_wrong_matches() -> None:
    first, second = rigid(120, 40)
    view = fit(first, second, "fundamental", Search(threshold=1.0))
    assert view.matrix is not None
    assert view.inliers[:80].all()
    assert view.inliers[80:].sum() <= 4  # a random point lies near its epipolar line now and then
    a, b = (np.column_stack([points[:80], np.ones(80)]) for points in (first, second))
    lines = a @ view.matrix.T
    distance = np.abs((b * lines).sum(axis=1)) / np.linalg.norm(lines[:, :2], axis=1)
    assert distance.max() < 0.5


@pytest.mark.parametrize("kind", ["homography", "fundamental"])
def test_the_result_does_not_depend_on_opencvs_seed(kind: str) -> None:
    first, second = planar(100, 60)
    cv2.setRNGSeed(1)
    one = fit(first, second, kind)
    cv2.setRNGSeed(77)
    two = fit(first, second, kind)
    assert one.matrix is not None
    np.testing.assert_array_equal(one.matrix, two.matrix)
    np.testing.assert_array_equal(one.inliers, two.inliers)


@pytest.mark.parametrize(("kind", "count"), [("homography", 3), ("fundamental", 7), ("homography", 0)])
def test_too_few_matches_fit_nothing(kind: str, count: int) -> None:
    first, second = planar(10, 0)
    view = fit(first[:count], second[:count], kind)
    assert view.matrix is None
    assert view.inliers.shape == (count,)
    assert not view.inliers.any()


@pytest.mark.parametrize("kind", ["homography", "fundamental"])
def test_one_point_many_times_fits_nothing(kind: str) -> None:
    points = np.full((20, 2), 7.0, np.float32)
    assert fit(points, points, kind).matrix is None


def test_settings_out_of_range_are_named() -> None:
    first, second = planar(10, 0)
    with pytest.raises(SettingError, match="affine"):
        fit(first, second, "affine")
    with pytest.raises(SettingError, match="needs K"):
        fit(first, second, "essential")
    with pytest.raises(SettingError, match="threshold"):
        Search(threshold=0.0)


def by_binomials(matches: int, inliers: int, kind: str, threshold: float, size: tuple[float, float]) -> float:
    strip = 2 * threshold * math.hypot(*size)
    sample, solutions, within = {
        "homography": (4, 1, math.pi * threshold**2), "fundamental": (7, 3, strip), "essential": (5, 10, strip),
    }[kind]  # fmt: skip
    p = within / (size[0] * size[1])
    samples = math.comb(matches, inliers) * math.comb(inliers, sample)
    return solutions * (matches - sample) * samples * p ** (inliers - sample)


@pytest.mark.parametrize("kind", ["homography", "fundamental", "essential"])
@pytest.mark.parametrize(("matches", "inliers"), [(16, 9), (83, 12), (400, 30), (400, 390)])
def test_the_number_of_false_alarms(kind: str, matches: int, inliers: int) -> None:
    found = expected_by_chance(matches, inliers, kind, 3.0, (427, 640))
    assert found == pytest.approx(by_binomials(matches, inliers, kind, 3.0, (427, 640)), rel=1e-9)


def test_chance_at_its_limits() -> None:
    assert expected_by_chance(4, 4, "homography", 3.0, (400, 600)) == math.inf  # a sample fits itself
    assert expected_by_chance(100, 60, "homography", 300.0, (400, 600)) > 1  # everything is near everything
    assert expected_by_chance(100, 60, "homography", 3.0, (0, 0)) > 1
    assert expected_by_chance(100, 60, "fundamental", 3.0, (0, 0)) > 1
    assert 0 <= expected_by_chance(100_000, 99_000, "fundamental", 1.0, (4000, 6000)) < 1e-300
    assert expected_by_chance(100_000, 50, "fundamental", 1.0, (4000, 6000)) > 1e30


@pytest.mark.parametrize("kind", ["homography", "fundamental"])
@pytest.mark.parametrize("count", [10, 20, 80, 400])
def test_unrelated_matches_support_no_geometry(kind: str, count: int) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        first, second = rng.uniform(0, (640, 480), (2, count, 2)).astype(np.float32)
        view = fit(first, second, kind)
        assert not view.supported, (seed, view)


@pytest.mark.parametrize(("kind", "points"), [("homography", planar), ("fundamental", rigid)])
def test_a_true_geometry_is_supported(kind: str, points: object) -> None:
    assert callable(points)
    assert fit(*points(100, 40), kind).supported
    assert fit(*points(40, 20), kind).supported


def test_a_two_view_says_what_it_is() -> None:
    view = fit(*planar(100, 40), "homography")
    assert repr(view) == f"TwoView(homography: {view.inliers.sum()} inliers of 100 matches)"
    assert repr(TwoView("fundamental", None, np.zeros(3, np.bool_))) == "TwoView(fundamental: none fitted)"


def test_two_views_are_compared_by_identity() -> None:
    one, two = (TwoView("homography", np.eye(3), np.ones(4, np.bool_)) for _ in range(2))
    assert one in [one]
    assert one != two
