"""Characteristic sizes and centres, held against blobs whose size is known and against a plain loop in float64."""

from __future__ import annotations

import math

import numpy as np
import pytest

from elf_runtime.detection.scale_space import MIDDLE, OCTAVES, ScaleSpace
from helpers import textured


def blob(sigma: float, centre: tuple[float, float], size: tuple[int, int] = (90, 110), sign: float = 1.0) -> np.ndarray:
    y, x = np.mgrid[: size[0], : size[1]]
    bump = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * sigma**2))
    return np.repeat((0.5 + sign * 0.4 * bump)[..., None], 3, axis=2).astype(np.float32)


def smoothed(image: np.ndarray, sigma: float) -> np.ndarray:
    """By a Gaussian of 8 sigma, in float64, mirrored as OpenCV does."""
    reach = math.ceil(8 * sigma)
    weights = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * sigma**2))
    weights /= weights.sum()
    framed = np.pad(image.astype(np.float64), reach, mode="reflect")
    along = np.apply_along_axis(lambda row: np.convolve(row, weights, "valid"), 1, framed)
    return np.apply_along_axis(lambda column: np.convolve(column, weights, "valid"), 0, along)


def response(image: np.ndarray, octave: float) -> np.ndarray:
    """|G(k s) - G(s / k)| for s = MIDDLE 2^octave, k^2 a quarter of an octave."""
    sigma, k = MIDDLE * 2**octave, 2**0.125
    return np.abs(smoothed(image, sigma * k) - smoothed(image, sigma / k))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("octave", [-0.9, -0.5, -0.1, 0.0, 0.3, 0.77, 0.95])
def test_a_gaussian_blob_has_its_own_size(octave: float, sign: float) -> None:
    """|t^2 / (t^2 + k^2 s^2) - t^2 / (t^2 + s^2 / k^2)|, its response at the centre, is largest at s = t."""
    space = ScaleSpace(blob(MIDDLE * 2**octave, (50, 40), sign=sign))
    (found,) = space.octaves(np.array([(50, 40)], np.float32))
    assert abs(found - octave) < 0.04


@pytest.mark.parametrize(("sigma", "end"), [(0.7, -OCTAVES), (12.0, OCTAVES)])
def test_what_is_smaller_or_larger_is_at_the_end(sigma: float, end: float) -> None:
    space = ScaleSpace(blob(sigma, (50, 40)))
    assert space.octaves(np.array([(50, 40)], np.float32)).tolist() == [end]


@pytest.mark.parametrize("octave", [-0.75, 0.0, 0.75])
@pytest.mark.parametrize("away", [(0.0, 0.0), (1.2, -0.7), (-1.0, 1.0)])
def test_the_centre_of_a_blob_is_found(away: tuple[float, float], octave: float) -> None:
    centre = (50.3, 39.6)
    space = ScaleSpace(blob(MIDDLE * 2**octave, centre))
    start = (np.array([centre]) + away).astype(np.float32)
    np.testing.assert_allclose(space.centres(start, np.array([octave])), [centre], atol=0.06)


def test_a_centre_that_is_too_far_leaves_the_point() -> None:
    space = ScaleSpace(blob(MIDDLE, (50, 40)))
    for away in (2.7, 5.0):  # farther than sigma, and more steps than are taken
        start = np.array([(50 + away, 40)], np.float32)
        np.testing.assert_array_equal(space.centres(start, np.zeros(1)), start)


def test_the_plain_loop_s() -> None:
    pixels = textured(60, 70).astype(np.float32)
    grey = pixels.mean(axis=2)
    space = ScaleSpace(pixels)
    steps = np.arange(-5, 6) / 4
    maps = [response(grey, octave) for octave in steps]
    points = np.random.default_rng(0).integers(6, (64, 54), (40, 2)) + np.array([0.25, 0.5])
    expected, inner = [], 0
    for x, y in np.floor(points).astype(int):
        corners = [(0.375, y, x), (0.125, y, x + 1), (0.375, y + 1, x), (0.125, y + 1, x + 1)]
        at = [sum(share * one[row, column] for share, row, column in corners) for one in maps]
        peaks = [i for i in range(1, 10) if at[i] >= at[i - 1] and at[i] > at[i + 1]]
        if peaks:
            i = max(peaks, key=at.__getitem__)
            inner += 1
            expected.append(steps[i] + (at[i - 1] - at[i + 1]) / (at[i - 1] - 2 * at[i] + at[i + 1]) / 2 / 4)
        else:
            expected.append(-1.0 if at[1] >= at[9] else 1.0)
    assert inner > 20
    found = space.octaves(points.astype(np.float32))
    near = np.abs(found - np.clip(expected, -1, 1)) < 0.03
    assert near.mean() > 0.94  # where two maxima are nearly as high, the shorter Gaussians may choose the other


def test_outside_stands_at_the_edge_and_nothing_is_fine() -> None:
    space = ScaleSpace(textured(40, 50).astype(np.float32))
    outside, edge = np.array([(-9, 5), (70, 70)], np.float32), np.array([(0, 5), (49, 39)], np.float32)
    np.testing.assert_array_equal(space.octaves(outside), space.octaves(edge))
    assert space.octaves(outside[:0]).shape == (0,)
    assert space.centres(outside[:0], np.zeros(0)).shape == (0, 2)


@pytest.mark.parametrize("size", [(1, 1), (2, 9), (1, 40)])
def test_images_of_few_pixels(size: tuple[int, int]) -> None:
    space = ScaleSpace(np.full((*size, 3), 0.5, np.float32))
    points = np.zeros((1, 2), np.float32)
    octaves = space.octaves(points)
    assert np.abs(octaves).max() <= OCTAVES
    np.testing.assert_array_equal(space.centres(points, octaves), points)
