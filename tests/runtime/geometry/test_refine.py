"""Refined matches of images that are shifted by a known part of a pixel, or in a way that can't be followed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import Features, ImageError, Matches, SettingError, refine
from elf_runtime.geometry.refine import _evened
from helpers import textured

SHIFT = np.array([73, -51]) / 32  # OpenCV 4 warps in steps of 1/32 pixel


def warped(image: np.ndarray, matrix: Any) -> np.ndarray:
    """(x, y) of the image at matrix (x, y, 1) of the result."""
    size = (image.shape[1], image.shape[0])
    return cv2.warpAffine(
        image, np.asarray(matrix, np.float64), size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


def shifted(image: np.ndarray) -> np.ndarray:
    return warped(image, [[1, 0, SHIFT[0]], [0, 1, SHIFT[1]]])


def features(points: np.ndarray, image: np.ndarray) -> Features:
    count = len(points)
    return Features(
        points.astype(np.float32), np.ones(count, np.float32), np.zeros((count, 0), np.float32), image.shape[:2]
    )


def paired(count: int) -> Matches:
    index = np.arange(count)
    return Matches(np.stack([index, index], axis=1), np.ones(count, np.float32), np.zeros(count, np.float32))


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return cv2.GaussianBlur(textured(200, 260), (0, 0), 1.0)


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return np.random.default_rng(3).uniform((30, 30), (230, 170), (80, 2)).round(2)


def errors(points: np.ndarray, image: Any, other: Any, guess: np.ndarray, truth: np.ndarray, **more: Any) -> np.ndarray:
    """Distances of the refined places from the true ones."""
    size = np.zeros((200, 260))
    places = refine(paired(len(points)), features(points, size), features(guess, size), image, other, **more)
    assert (places.dtype, places.shape) == (np.float32, (len(points), 2))
    return np.linalg.norm(places - truth, axis=1)


def noisy(truth: np.ndarray, sigma: float = 1.0) -> np.ndarray:
    return truth + np.random.default_rng(5).normal(0, sigma, truth.shape)


def test_a_shift_is_found_to_a_small_part_of_a_pixel(image: np.ndarray, points: np.ndarray) -> None:
    truth = points + SHIFT
    guess = noisy(truth)
    before, after = np.linalg.norm(guess - truth, axis=1), errors(points, image, shifted(image), guess, truth)
    assert np.median(before) > 1
    assert np.median(after) < 0.05
    assert (after < 0.15).mean() > 0.95


@pytest.mark.parametrize("change", ["darker", "uint16", "twelve bits", "float", "gray", "path"])
def test_light_and_type_of_the_image_do_not_matter(
    image: np.ndarray, points: np.ndarray, change: str, tmp_path: Path
) -> None:
    other: Any = shifted(image)
    if change == "darker":
        other = np.round(0.4 * other + np.linspace(0, 60, other.shape[1])[:, None]).astype(np.uint8)
    elif change == "uint16":
        other = other.astype(np.uint16) * np.uint16(257)
    elif change == "twelve bits":
        other = other.astype(np.uint16) * np.uint16(16)
    elif change == "float":
        other = other / 255
    elif change == "gray":
        other = cv2.cvtColor(other, cv2.COLOR_BGR2GRAY)
    else:
        cv2.imwrite(str(tmp_path / "other.png"), other)
        other = tmp_path / "other.png"
    truth = points + SHIFT
    after = errors(points, image, other, noisy(truth), truth)
    assert np.median(after) < 0.15
    assert (after < 0.3).mean() > 0.9


def test_right_places_stay_right(image: np.ndarray, points: np.ndarray) -> None:
    truth = points + SHIFT
    assert errors(points, image, shifted(image), truth, truth).max() < 0.1


def test_what_cannot_be_followed_stays(image: np.ndarray, points: np.ndarray) -> None:
    """In another picture, the image turned by half a turn, and flat ones, nearly all matches stay where they are."""
    flat = np.full_like(image, 90)
    for other, most in ((textured(200, 260, seed=9), 0.05), (image[::-1, ::-1], 0.05), (flat, 0.0)):
        moved = errors(points, image, other, points, points) > 1e-4
        assert moved.mean() <= most
    assert errors(points, flat, flat, points, points).max() < 1e-4


def test_a_turn_and_a_change_of_scale_do_no_harm(image: np.ndarray, points: np.ndarray) -> None:
    centre = np.array([130.0, 100.0])
    for degrees, scale in ((20.0, 1.0), (0.0, 1.3), (45.0, 0.7)):
        matrix = cv2.getRotationMatrix2D(tuple(centre), degrees, scale)
        truth = points @ matrix[:, :2].T + matrix[:, 2]
        inside = ((truth > 15) & (truth < (244, 184))).all(axis=1)
        guess = noisy(truth[inside], 1.5)
        before = np.linalg.norm(guess - truth[inside], axis=1)
        after = errors(points[inside], image, warped(image, matrix), guess, truth[inside])
        assert np.median(after) < np.median(before) + 1e-4
        assert (after > before + 1).mean() < 0.05


def test_each_gate_keeps_matches_back(image: np.ndarray, points: np.ndarray) -> None:
    truth = points + SHIFT
    guess, other = noisy(truth), shifted(image)
    free = errors(points, image, other, guess, guess)
    near = errors(points, image, other, guess, guess, max_move=1.0)
    assert (free > 1).any()
    assert near.max() < 1
    np.testing.assert_array_equal(near[free < 0.99], free[free < 0.99])
    assert errors(points, image, other, guess, guess, min_correlation=1.0).max() < 1e-4


def test_what_moves_comes_back_and_looks_more_alike(image: np.ndarray, points: np.ndarray) -> None:
    """By OpenCV and numpy, on the evened images, of a view in which many searches go wrong."""
    matrix = cv2.getRotationMatrix2D((130.0, 100.0), 25, 1.1)
    other = warped(image, matrix)
    truth = points @ matrix[:, :2].T + matrix[:, 2]
    first, guess = points.astype(np.float32), noisy(truth, 4.0).astype(np.float32)
    a, b = features(first, image), features(guess, other)
    free = {"min_correlation": -1.0, "max_move": 50.0}
    places = refine(paired(80), a, b, image, other, **free)
    moved = np.linalg.norm(places - guess, axis=1) > 1e-4
    even_a, even_b = _evened(image, a, "first"), _evened(other, b, "second")

    def followed(source: np.ndarray, target: np.ndarray, start: np.ndarray, near: np.ndarray) -> np.ndarray:
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01)
        flow = cv2.OPTFLOW_USE_INITIAL_FLOW
        return cv2.calcOpticalFlowPyrLK(
            source, target, start.copy(), near.copy(), winSize=(13, 13), maxLevel=0, criteria=stop, flags=flow
        )[0]

    def alike(index: int, place: np.ndarray) -> float:
        of = ((even_a, first[index]), (even_b, place))
        patches = [cv2.getRectSubPix(even.astype(np.float32), (19, 19), at.tolist()) for even, at in of]
        return float(np.corrcoef(patches[0].ravel(), patches[1].ravel())[0, 1])

    found = followed(even_a, even_b, first, guess)
    away = np.linalg.norm(followed(even_b, even_a, found, first) - first, axis=1)
    gain = np.array([alike(i, found[i]) - alike(i, guess[i]) for i in range(80)])
    clear = (np.abs(away - 0.5) > 0.01) & (np.abs(gain) > 0.01)  # patches are interpolated in two ways
    assert ((away > 0.5) & (gain > 0) & clear).any()
    assert ((away < 0.5) & (gain < 0) & clear).any()
    assert (moved == (away < 0.5) & (gain > 0))[clear].all()


def test_images_of_two_sizes(image: np.ndarray, points: np.ndarray) -> None:
    truth, inside = points + SHIFT, points[:, 0] < 180
    guess, other = noisy(truth)[inside], shifted(image)[:190, :200]
    first, second = features(points[inside], image), features(guess, other)
    whole = errors(points[inside], image, shifted(image), guess, truth[inside])
    part = refine(paired(len(guess)), first, second, image, other) - truth[inside]
    np.testing.assert_allclose(np.linalg.norm(part, axis=1), whole, atol=0.02)


def test_points_at_the_edge_and_beyond_stay_finite(image: np.ndarray) -> None:
    edge = np.array([[0, 0], [259, 199], [-5, 20], [300, 250], [0.4, 198.7]])
    assert np.isfinite(errors(edge, image, shifted(image), edge + 1, edge)).all()


def test_many_points_go_in_bands(image: np.ndarray, points: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = points + SHIFT
    whole = errors(points, image, shifted(image), noisy(truth), truth)
    monkeypatch.setattr("elf_runtime.geometry.refine._BAND", 7)
    np.testing.assert_array_equal(errors(points, image, shifted(image), noisy(truth), truth), whole)


def test_no_matches_are_no_points(image: np.ndarray) -> None:
    assert errors(np.zeros((0, 2)), image, image, np.zeros((0, 2)), np.zeros((0, 2))).shape == (0,)


def test_what_cannot_be_refined(image: np.ndarray, points: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="the second image has 259x200 pixels, but its features are of one of 260x200"):
        errors(points, image, image[:, 1:], points, points)
    with pytest.raises(ImageError, match=r"the first image: float images are in \[0, 1\]"):
        errors(points, image * 1.0, image, points, points)
    with pytest.raises(ImageError, match=r"missing.png: "):
        errors(points, image, tmp_path / "missing.png", points, points)
    for name, values in {
        "window": (4, 3, 12, 13.0, True),
        "max_move": (0, -1, float("nan"), "6"),
        "min_correlation": (1.1, -2, float("nan"), None),
    }.items():
        for value in values:
            with pytest.raises(SettingError, match=name):
                errors(points, image, image, points, points, **{name: value})
