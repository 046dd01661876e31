"""Squares of one image in another: their correlation, the affine map that aligns them, and what has no texture."""

from __future__ import annotations

import warnings

import cv2
import numpy as np
import pytest

from elf_runtime.geometry.alignment import UPRIGHT, Squares
from helpers import textured

SHAPE = np.array([[1.1, 0.15], [-0.1, 0.9]], np.float32)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return cv2.GaussianBlur(cv2.cvtColor(textured(160, 200), cv2.COLOR_BGR2GRAY).astype(np.float32), (0, 0), 1.5)


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return np.random.default_rng(1).uniform((40, 40), (160, 120), (40, 2)).astype(np.float32)


def upright(count: int) -> np.ndarray:
    return np.tile(UPRIGHT, (count, 1, 1))


def test_the_correlation_is_that_of_what_a_plane_leaves(image: np.ndarray, points: np.ndarray) -> None:
    """By least squares in float64, for whole pixels, with another plane on each patch."""
    whole, (dy, dx) = points.round(), np.mgrid[-5:6, -5:6]
    there = whole + np.float32([3, -2])
    planes = np.stack([np.ones(121), dx.ravel(), dy.ravel()], axis=1)

    def rest(pixels: np.ndarray) -> np.ndarray:
        return pixels - planes @ np.linalg.lstsq(planes, pixels, rcond=None)[0]

    def patch(x: float, y: float) -> np.ndarray:
        return image[int(y) + dy, int(x) + dx].ravel().astype(np.float64)

    wanted = []
    for first, second in zip(whole, there, strict=True):
        a, b = rest(patch(*first)), rest(patch(*second))
        wanted.append(a @ b / np.sqrt((a @ a) * (b @ b)))
    ramp = 0.4 * image + np.linspace(0, 900, 200, dtype=np.float32)
    squares = Squares(image, whole, 11)
    np.testing.assert_allclose(squares.correlation(image, there, upright(40)), wanted, atol=1e-4)
    np.testing.assert_allclose(squares.correlation(ramp, there, upright(40)), wanted, atol=1e-3)
    np.testing.assert_allclose(squares.correlation(ramp, whole, upright(40)), 1, atol=1e-4)


def test_place_and_shape_are_found(image: np.ndarray, points: np.ndarray) -> None:
    centre = np.float32([100, 80])
    matrix = np.column_stack([SHAPE, centre - SHAPE @ centre])
    other = cv2.warpAffine(image, matrix.astype(np.float64), (200, 160), flags=cv2.INTER_CUBIC)
    truth = (points @ matrix[:, :2].T + matrix[:, 2]).astype(np.float32)
    start = truth + np.random.default_rng(2).normal(0, 0.5, truth.shape).astype(np.float32)
    places, shapes = Squares(image, points, 21).aligned(other, start, upright(40))
    assert np.median(np.linalg.norm(places - truth, axis=1)) < 0.03
    assert np.median(np.abs(shapes - SHAPE).max(axis=(1, 2))) < 0.01


@pytest.mark.parametrize("kind", ["flat", "edge", "noise"])
def test_what_leads_nowhere_is_no_error(image: np.ndarray, points: np.ndarray, kind: str) -> None:
    """A flat square, a straight edge along which nothing tells places apart, and noise, in another picture."""
    made = np.full_like(image, 90)
    if kind == "edge":
        made[:, 100:] = 250
    elif kind == "noise":
        made = np.random.default_rng(3).uniform(0, 255, image.shape).astype(np.float32)
    far = np.concatenate([points[:-2], np.float32([[-1e4, 5], [1e6, -1e6]])])
    wild = np.random.default_rng(4).normal(0, 1, (40, 2, 2)).astype(np.float32)
    wild[:5] = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        squares = Squares(made, points, 21)
        for shapes in (upright(40), wild):
            places, found = squares.aligned(image, far, shapes)
            assert (places.shape, found.shape) == ((40, 2), (40, 2, 2))
            alike = squares.correlation(image, places, found)
            assert not (np.abs(alike) > 1.0001).any()
    if kind == "flat":
        np.testing.assert_allclose(squares.correlation(image, points, upright(40)), 0, atol=1e-5)
