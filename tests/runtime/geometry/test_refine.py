"""Refined matches of images that are shifted by a known part of a pixel, or in a way that can't be followed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import Features, ImageError, Matches, SettingError, refine
from helpers import textured

SHIFT = np.array([73, -51]) / 32  # OpenCV 4 warps in steps of 1/32 pixel


def warped(image: np.ndarray, matrix: Any) -> np.ndarray:
    """(x, y) of the image at matrix (x, y, 1) of the result; OpenCV's cubic kernel would be off by 0.04 pixels."""
    size = (image.shape[1], image.shape[0])
    return cv2.warpAffine(
        image, np.asarray(matrix, np.float64), size, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT
    )


def shifted(image: np.ndarray) -> np.ndarray:
    return warped(image, [[1, 0, SHIFT[0]], [0, 1, SHIFT[1]]])


def features(points: np.ndarray, image: np.ndarray, size: float = 9.0, angle: float = -1.0) -> Features:
    count = len(points)
    one = np.ones(count, np.float32)
    nothing = np.zeros((count, 0), np.float32)
    return Features(points.astype(np.float32), one, nothing, image.shape[:2], sizes=size * one, angles=angle * one)


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


def seen_by(image: np.ndarray, points: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, ...]:
    """The warped image, the points that lie well inside it, and where they are there."""
    truth = points @ matrix[:, :2].T + matrix[:, 2]
    inside = ((truth > 20) & (truth < (239, 179))).all(axis=1)
    assert inside.sum() > 25
    return warped(image, matrix), points[inside], truth[inside]


VIEWS = {"tilted": [[1.0, 0.25, -20], [0.0, 0.8, 20]], "turned": [[0.98, -0.2, 20], [0.2, 0.98, -20]]}


@pytest.mark.parametrize("view", VIEWS)
def test_a_change_of_view_is_followed(image: np.ndarray, points: np.ndarray, view: str) -> None:
    other, first, truth = seen_by(image, points, np.array(VIEWS[view]))
    after = errors(first, image, other, noisy(truth, 0.7), truth)
    assert np.median(after) < 0.05
    assert (after < 0.1).mean() > 0.8


@pytest.mark.parametrize(("degrees", "scale"), [(120.0, 1.0), (0.0, 1.6), (-70.0, 0.7), (350.0, 1.0)])
def test_the_turn_and_zoom_that_features_tell_are_followed(
    image: np.ndarray, points: np.ndarray, degrees: float, scale: float
) -> None:
    # OpenCV turns counterclockwise as seen; angles count from x towards y, which points down.
    matrix = cv2.getRotationMatrix2D((130.0, 100.0), -degrees, scale)
    other, first, truth = seen_by(image, points, matrix)
    guess = noisy(truth, 0.7)
    told = features(first, image, 10.0, 300.0), features(guess, other, 10.0 * scale, (300.0 + degrees) % 360)
    places = refine(paired(len(first)), *told, image, other)
    assert np.median(np.linalg.norm(places - truth, axis=1)) < 0.05
    if degrees == 120.0:
        assert np.median(errors(first, image, other, guess, truth)) > 0.3  # not followed without being told


def test_a_turn_and_a_change_of_scale_do_no_harm(image: np.ndarray) -> None:
    """Of which the features tell nothing; many points, as the last of these spoils one in forty."""
    centre = np.array([130.0, 100.0])
    points = np.random.default_rng(3).uniform((30, 30), (230, 170), (1000, 2)).round(2)
    for degrees, scale in ((20.0, 1.0), (0.0, 1.3), (45.0, 0.7)):
        matrix = cv2.getRotationMatrix2D(tuple(centre), degrees, scale)
        truth = points @ matrix[:, :2].T + matrix[:, 2]
        inside = ((truth > 15) & (truth < (244, 184))).all(axis=1)
        guess = noisy(truth[inside], 1.5)
        before = np.linalg.norm(guess - truth[inside], axis=1)
        after = errors(points[inside], image, warped(image, matrix), guess, truth[inside])
        assert np.median(after) < np.median(before) + 1e-4
        assert (after > before + 1).mean() < 0.05


def test_a_wrong_turn_and_zoom_do_no_harm(image: np.ndarray, points: np.ndarray) -> None:
    truth = points + SHIFT
    told = features(points, image, 10.0, 10.0), features(noisy(truth), image, 25.0, 200.0)
    places = refine(paired(len(points)), *told, image, shifted(image))
    np.testing.assert_array_equal(
        np.linalg.norm(places - truth, axis=1), errors(points, image, shifted(image), noisy(truth), truth)
    )


def test_places_are_those_of_the_highest_correlation(image: np.ndarray, points: np.ndarray) -> None:
    """Against OpenCV's findTransformECC, which ascends the correlation of a patch by affine maps, one at a time."""
    other, first, truth = seen_by(image, points, np.array([[1.0, 0.03, -2], [0.0, 0.97, 2]]))
    noise = np.random.default_rng(2).normal(0, 3, other.shape)
    other = np.clip(other + noise, 0, 255).astype(np.uint8)
    guess = noisy(truth, 0.5)
    a, b = features(first, image), features(guess, other)
    places = refine(paired(len(first)), a, b, image, other, min_correlation=-1.0)
    grays = [cv2.cvtColor(each, cv2.COLOR_BGR2GRAY).astype(np.float32) for each in (image, other)]
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    apart, ours, theirs = [], [], []
    for point, start, place, right in zip(first, guess, places, truth, strict=True):
        patch = cv2.getRectSubPix(grays[0], (31, 31), point.astype(np.float32).tolist())
        warp = np.array([[1, 0, start[0] - 15], [0, 1, start[1] - 15]], np.float32)
        try:
            _, warp = cv2.findTransformECC(patch, grays[1], warp, cv2.MOTION_AFFINE, stop, None, 1)
        except cv2.error:  # it says so when it does not converge
            continue
        found = warp @ (15, 15, 1)
        for errors_of, error in ((apart, found - place), (ours, place - right), (theirs, found - right)):
            errors_of.append(np.linalg.norm(error))
    assert len(apart) > 20
    assert np.median(apart) < 0.03
    assert np.quantile(apart, 0.8) < 0.05
    assert np.median(ours) < 1.25 * np.median(theirs)  # whose shape is free


def test_each_gate_keeps_matches_back(image: np.ndarray, points: np.ndarray) -> None:
    truth = points + SHIFT
    guess, other = noisy(truth), shifted(image)
    free = errors(points, image, other, guess, guess)
    near = errors(points, image, other, guess, guess, max_move=1.0)
    assert (free > 1).any()
    assert near.max() < 1
    np.testing.assert_array_equal(near[free < 0.99], free[free < 0.99])
    assert errors(points, image, other, guess, guess, min_correlation=1.0).max() < 1e-4


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


def test_no_place_is_found_outside_the_image(image: np.ndarray) -> None:
    y, size = np.linspace(20, 180, 60), np.zeros((200, 260))

    def refined(x: float) -> tuple[np.ndarray, ...]:
        first = np.stack([np.full(60, x), y], axis=1)
        guess = (first + np.array([0.5, -1])).astype(np.float32)
        return first, guess, refine(paired(60), features(first, size), features(guess, size), image, shifted(image))

    first, _, places = refined(254.0)
    assert np.median(np.linalg.norm(places - first - SHIFT, axis=1)) < 0.2
    _, guess, places = refined(258.0)  # 0.8 pixels beyond the second image's edge
    np.testing.assert_array_equal(places[places[:, 0] >= 259.5], np.zeros((0, 2)))
    assert (places == guess).all(axis=1).mean() > 0.9


@pytest.mark.parametrize("blurred", [0, 1])
def test_another_sharpness_spoils_few_matches(image: np.ndarray, points: np.ndarray, blurred: int) -> None:
    """Blur looks like a zoom to a square that may take any shape."""
    truth = points + SHIFT
    pair = [image, shifted(image)]
    pair[blurred] = cv2.GaussianBlur(pair[blurred], (0, 0), 2.0)
    guess = noisy(truth, 0.4)
    before, after = np.linalg.norm(guess - truth, axis=1), errors(points, *pair, guess, truth)
    assert np.median(after) < 0.5 * np.median(before)
    assert ((before < 1) & (after > 1)).mean() < 0.05


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_matches_do_not_slide_along_straight_edges(noise: float) -> None:
    rng = np.random.default_rng(6)
    drawn = np.full((200, 260, 3), 60, np.uint8)
    cv2.rectangle(drawn, (60, 40), (200, 160), (190, 190, 190), -1)
    x = np.concatenate([np.full(40, 59.5), np.full(40, 200.5)])
    first = np.stack([x, np.tile(np.linspace(70, 130, 40), 2)], axis=1)
    truth = first + SHIFT
    other = np.clip(shifted(drawn) + rng.normal(0, noise, drawn.shape), 0, 255).round().astype(np.uint8)
    guess = noisy(truth, 0.3)
    before, after = np.linalg.norm(guess - truth, axis=1), errors(first, drawn, other, guess, truth)
    assert (after > before + 0.5).mean() < 0.03


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
    wide = np.zeros((200, 32767), np.uint8)
    with pytest.raises(ImageError, match="the second image has a side above 32766 pixels"):
        refine(paired(80), features(points, image), features(points, wide), image, wide)
    with pytest.raises(SettingError, match=r"matches are Matches, as of .*, not ndarray"):
        refine(np.zeros((3, 2), np.int64), features(points, image), features(points, image), image, image)  # type: ignore[arg-type]
    for name, values in {
        "window": (4, 3, 12, 13.0, True, 103),
        "max_move": (0, -1, float("nan"), "6"),
        "min_correlation": (1.1, -2, float("nan"), None),
    }.items():
        for value in values:
            with pytest.raises(SettingError, match=name):
                errors(points, image, image, points, points, **{name: value})
