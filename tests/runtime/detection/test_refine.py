"""Sub-pixel refinement on peaks whose place is known."""

from __future__ import annotations

import numpy as np
import pytest

from elf_runtime.detection.refine import quadratic_peaks


def bump(x: float, y: float, size: int = 21, width: float = 2.5) -> np.ndarray:
    v, u = np.mgrid[:size, :size]
    return np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * width**2)).astype(np.float32)


def test_a_quadratic_surface_is_found_exactly() -> None:
    v, u = np.mgrid[:9, :11]
    scores = (50 - (u - 5.3) ** 2 - 2 * (v - 3.8) ** 2 - 0.9 * (u - 5.3) * (v - 3.8)).astype(np.float32)
    assert quadratic_peaks(scores, np.array([[5, 4]])) == pytest.approx(np.array([[5.3, 3.8]]), abs=1e-4)


@pytest.mark.parametrize(("x", "y"), [(10.0, 10.0), (10.4, 9.7), (9.51, 10.49), (10.2, 10.2)])
def test_a_gaussian_is_found_to_a_fiftieth_of_a_pixel(x: float, y: float) -> None:
    found = quadratic_peaks(bump(x, y), np.array([[round(x), round(y)]]))[0]
    assert np.abs(found - [x, y]).max() < 0.02


def test_a_slanted_ridge_is_found_where_parabolas_along_the_axes_are_off() -> None:
    v, u = np.mgrid[:21, :21].astype(np.float64)
    along, across = (u - 10.3) + (v - 9.8), (u - 10.3) - (v - 9.8)
    scores = np.exp(-((along / 6) ** 2) / 2 - ((across / 2) ** 2) / 2).astype(np.float32)
    assert np.abs(quadratic_peaks(scores, np.array([[10, 10]])) - [10.3, 9.8]).max() < 0.05


def test_at_the_border_it_moves_along_it() -> None:
    v, u = np.mgrid[:9, :11]
    scores = (50 - (u - 5.3) ** 2 - (v + 0.4) ** 2).astype(np.float32)
    assert quadratic_peaks(scores, np.array([[5, 0]])) == pytest.approx(np.array([[5.3, 0]]), abs=1e-4)


def test_what_is_no_peak_stays() -> None:
    flat = np.ones((5, 5), np.float32)
    ramp = np.arange(25, dtype=np.float32).reshape(5, 5)
    for scores in (flat, ramp):
        points = np.array([[0, 0], [2, 2], [4, 4], [0, 2], [2, 4]])
        assert quadratic_peaks(scores, points).tolist() == points.tolist()


def test_never_more_than_half_a_pixel() -> None:
    scores = np.random.default_rng(0).integers(0, 4, (60, 60)).astype(np.float32)
    points = np.stack(np.meshgrid(np.arange(60), np.arange(60)), -1).reshape(-1, 2)
    assert np.abs(quadratic_peaks(scores, points) - points).max() <= 0.5


@pytest.mark.parametrize("slanted", [False, True])
def test_along_an_edge_only_noise_makes_tops(slanted: bool) -> None:
    """Across it a keypoint moves to the top; along it, where all places are equal but for noise, it stays."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:40, :40]
    across = (u - v) / np.sqrt(2) if slanted else u - 20.3
    ridge = (2000 - 20 * across**2) * (1 + 1e-6 * rng.standard_normal((40, 40)))
    points = np.stack([np.arange(5, 35)] * 2, axis=1) if slanted else np.array([(20, y) for y in range(5, 35)])
    wanted = points + ([0, 0] if slanted else [0.3, 0])
    np.testing.assert_allclose(quadratic_peaks(ridge.astype(np.float32), points), wanted, atol=0.01)


def test_of_two_equal_pixels_either_is_a_maximum() -> None:
    v = np.mgrid[:9, :30][0]
    ridge = 1 - 0.1 * (v - 4.5) ** 2
    noisy = (ridge * (1 + 1e-7 * np.random.default_rng(0).standard_normal(ridge.shape))).astype(np.float32)
    for row in (4, 5):
        points = np.array([(x, row) for x in range(3, 27)])
        np.testing.assert_allclose(quadratic_peaks(noisy, points)[:, 1], 4.5, atol=1e-4)


@pytest.mark.parametrize(("curvature", "moves"), [(2.0**-11, True), (2.0**-13, False)])
def test_what_is_flat_is_a_share_of_the_value(curvature: float, moves: bool) -> None:
    for value in (1e-3, 200.0):
        u = np.arange(9)
        row = value * (1 - curvature * (u - 4.25) ** 2 / 2)
        found = quadratic_peaks(np.tile(row, (9, 1)).astype(np.float32), np.array([[4, 4]]))
        np.testing.assert_allclose(found, [[4.25 if moves else 4, 4]], atol=0.02)


def test_no_points() -> None:
    assert quadratic_peaks(bump(3, 3), np.zeros((0, 2), np.int64)).shape == (0, 2)
