"""Orientations of keypoints, held against a plain loop and pictures whose gradients are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from elf_runtime.detection import orientation
from elf_runtime.detection.orientation import BINS, orientations
from helpers import textured


def by_loop(pixels: np.ndarray, x: int, y: int, sigma: float) -> float:
    """The orientation at a pixel, pixel by pixel, in Python's floats."""
    height, width = pixels.shape[:2]
    g = pixels.astype(np.float64).mean(axis=2)
    reach = round(3 * sigma)
    histogram = [0.0] * BINS
    for v in range(max(0, y - reach), min(height, y + reach + 1)):
        for u in range(max(0, x - reach), min(width, x + reach + 1)):
            square = (u - x) ** 2 + (v - y) ** 2
            if square > reach**2:
                continue
            # Mirrored at the border, what is before the first pixel is also behind it.
            gx = (g[v, u + 1] - g[v, u - 1]) / 2 if 0 < u < width - 1 else 0.0
            gy = (g[v + 1, u] - g[v - 1, u]) / 2 if 0 < v < height - 1 else 0.0
            place = math.degrees(math.atan2(gy, gx)) % 360 / (360 / BINS)
            share = place - math.floor(place)
            amount = math.hypot(gx, gy) * math.exp(-square / (2 * sigma**2))
            histogram[int(place) % BINS] += amount * (1 - share)
            histogram[(int(place) + 1) % BINS] += amount * share
    for _ in range(6):
        histogram = [(histogram[i - 1] + 2 * histogram[i] + histogram[(i + 1) % BINS]) / 4 for i in range(BINS)]
    top = max(range(BINS), key=histogram.__getitem__)
    before, at, after = histogram[top - 1], histogram[top], histogram[(top + 1) % BINS]
    return (top + (before - after) / (2 * (before - 2 * at + after))) * 360 / BINS % 360


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of angles in degrees, 0 to 180."""
    return np.abs((np.asarray(a, np.float64) - b + 180) % 360 - 180)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("sigma", [1.5, 4.0])
def test_the_plain_loop_s(sigma: float, channels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    pixels = textured(40, 60, channels=channels).astype(np.float32)
    points = np.array([(0, 0), (59, 39), (30, 20), (1, 38), (7, 5), (58, 12), (33, 3)])
    expected = [by_loop(pixels, x, y, sigma) for x, y in points]
    np.testing.assert_array_less(difference(orientations(pixels, points, sigma), expected), 1e-2)
    monkeypatch.setattr(orientation, "_BLOCK", 1)  # one point at a time
    np.testing.assert_array_less(difference(orientations(pixels, points + 0.4, sigma), expected), 1e-2)


def test_points_of_different_sigmas() -> None:
    pixels = textured(40, 60).astype(np.float32)
    points, sigmas = np.array([(30, 20), (12, 9), (44, 30), (7, 33)]), np.array([4.0, 2.25, 4.0, 5.5])
    alone = [orientations(pixels, point[None], sigma)[0] for point, sigma in zip(points, sigmas, strict=True)]
    np.testing.assert_array_equal(orientations(pixels, points, sigmas), alone)


@pytest.mark.parametrize("degrees", [0, 10, 45, 90, 133, 180, 271, 355])
def test_a_ramp_points_uphill(degrees: int) -> None:
    y, x = np.mgrid[:40, :50]
    ramp = x * math.cos(math.radians(degrees)) + y * math.sin(math.radians(degrees))
    (found,) = orientations(ramp[..., None].astype(np.float32), np.array([(25, 20)]), 3.0)
    assert 0 <= found < 360
    assert difference(found, degrees) < 0.4  # the parabola's own error between two bins


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_image_s_orientations_are_turned(quarters: int) -> None:
    pixels = textured(60, 80).astype(np.float32)
    points = np.random.default_rng(0).integers(0, (80, 60), (50, 2))
    turned, where = pixels, points
    for _ in range(quarters):  # counter-clockwise: (x, y) comes to (y, width - 1 - x)
        where = np.stack([where[:, 1], turned.shape[1] - 1 - where[:, 0]], axis=1)
        turned = np.rot90(turned)
    expected = orientations(pixels, points, 3.0) - 90 * quarters
    np.testing.assert_array_less(difference(orientations(turned, where, 3.0), expected), 1e-2)


def test_without_gradients_it_is_zero() -> None:
    flat = np.full((40, 40, 3), 9, np.float32)
    assert orientations(flat, np.array([(3, 3), (20, 20)]), 4.0).tolist() == [0, 0]
    assert orientations(flat, np.zeros((0, 2)), 4.0).shape == (0,)


def test_points_outside_stand_at_the_edge() -> None:
    pixels = textured(40, 50).astype(np.float32)
    outside, edge = np.array([(-9.0, 5), (70, 70)]), np.array([(0.0, 5), (49, 39)])
    np.testing.assert_array_equal(orientations(pixels, outside, 4.0), orientations(pixels, edge, 4.0))
