"""Geometry between the features of two images: planes and scenes that are known, and images of different things."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime, Features, Matches, SettingError, estimate
from elf_runtime.geometry.fit import METHODS
from helpers import TINY, shared, textured

HOMOGRAPHY = np.array([[0.9, 0.12, 15.0], [-0.08, 1.05, -9.0], [1e-4, -5e-5, 1.0]])
TURN = cv2.Rodrigues(np.array([0.02, 0.1, -0.03]))[0]
ALONG = np.array([-1.0, 0.1, 0.2]) / np.linalg.norm([-1.0, 0.1, 0.2])
K1 = np.array([[520.0, 0.0, 310.0], [0.0, 500.0, 250.0], [0.0, 0.0, 1.0]])
K2 = np.array([[780.0, 0.0, 330.0], [0.0, 770.0, 230.0], [0.0, 0.0, 1.0]])
KINDS = ("homography", "fundamental", "essential")


def scene_points(count: int, wrong: int, second_camera: np.ndarray = K1) -> tuple[np.ndarray, np.ndarray]:
    """Where two cameras see points of a scene with depth, float64; the last `wrong` are seen anywhere in the second."""
    rng = np.random.default_rng(1)
    scene = rng.uniform((-3, -2, 6), (3, 2, 14), (count, 3))
    seen = (scene @ K1.T, (scene @ TURN.T + ALONG) @ second_camera.T)
    first, second = (view[:, :2] / view[:, 2:] for view in seen)
    second[count - wrong :] = rng.uniform(0, (640, 480), (wrong, 2))
    return first, second


def plane_points(count: int, wrong: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    first = rng.uniform(0, (640, 480), (count, 2))
    second = cv2.perspectiveTransform(first[None], HOMOGRAPHY)[0]
    second[count - wrong :] = rng.uniform(0, (640, 480), (wrong, 2))
    return first, second


def described(first: np.ndarray, second: np.ndarray) -> tuple[Features, Features]:
    """Features whose descriptors match them in the order given, the second side's reversed."""
    rows = np.random.default_rng(2).standard_normal((len(first), 32))
    rows = (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)
    scores = np.ones(len(first), np.float32)
    return (
        Features(first.astype(np.float32), scores, rows, (480, 640)),
        Features(second[::-1].astype(np.float32), scores, rows[::-1].copy(), (480, 640)),
    )


def essential_matrix() -> np.ndarray:
    """[t]x R"""
    x, y, z = ALONG
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ TURN


def of_unit_norm(matrix: np.ndarray) -> np.ndarray:
    """Scaled to norm 1, its largest number positive: an epipolar matrix has no scale and no sign."""
    return matrix / np.linalg.norm(matrix) * np.sign(matrix.flat[np.abs(matrix).argmax()])


@pytest.mark.parametrize("method", METHODS)
def test_a_plane(method: str) -> None:
    view = estimate(*described(*plane_points(120, 50)), "homography", method=method)
    assert view is not None
    assert (view.kind, view.rotation, view.translation) == ("homography", None, None)
    assert view.matrix is not None
    np.testing.assert_allclose(view.matrix / view.matrix[2, 2], HOMOGRAPHY, atol=2e-3, rtol=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_a_scene(method: str) -> None:
    view = estimate(*described(*scene_points(150, 50)), "fundamental", method=method)
    assert view is not None
    assert view.matrix is not None
    first, second = (np.column_stack([points, np.ones(150)])[:100] for points in scene_points(150, 50))
    lines = first @ view.matrix.T
    distances = np.abs((second * lines).sum(axis=1)) / np.hypot(lines[:, 0], lines[:, 1])
    assert distances.max() < 1
    true = np.linalg.inv(K1).T @ essential_matrix() @ np.linalg.inv(K1)
    if method != "ransac":  # its last fit is not to all inliers
        assert distances.max() < 0.3
        np.testing.assert_allclose(of_unit_norm(view.matrix), of_unit_norm(true), atol=2e-3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("second_camera", [K1, K2])
def test_a_scene_of_known_cameras(method: str, second_camera: np.ndarray) -> None:
    first, second = described(*scene_points(150, 50, second_camera))
    K: Any = K1 if second_camera is K1 else (K1, K2)
    view = estimate(first, second, "essential", K, method=method)
    assert view is not None
    assert view.matrix is not None
    assert view.rotation is not None
    assert view.translation is not None
    loose = 1e-2 if method == "ransac" else 1e-3
    np.testing.assert_allclose(of_unit_norm(view.matrix), of_unit_norm(essential_matrix()), atol=loose)
    np.testing.assert_allclose(view.rotation, TURN, atol=loose)
    np.testing.assert_allclose(view.translation, ALONG, atol=2 * loose)
    assert view.inliers[view.indices[:, 0] < 100].mean() > 0.95
    assert view.inliers[view.indices[:, 0] >= 100].mean() < 0.1


def test_far_points_are_in_front_of_the_cameras() -> None:
    """At 60 to 140 times the distance between the cameras, which is beyond what OpenCV allows by default."""
    rng = np.random.default_rng(1)
    scene = rng.uniform((-30, -20, 60), (30, 20, 140), (200, 3))
    first, second = (view[:, :2] / view[:, 2:] for view in (scene @ K1.T, (scene @ TURN.T + ALONG) @ K1.T))
    view = estimate(*described(first, second), "essential", K1)
    assert view is not None
    assert view.inliers.all()


def test_says_which_matches_and_where() -> None:
    first, second = described(*plane_points(120, 50))
    view = estimate(first, second, "homography")
    assert view is not None
    matches = Matches.between(first, second)
    assert view.indices is not None
    assert view.points is not None
    np.testing.assert_array_equal(view.indices, matches.indices)
    for found, wanted in zip(view.points, matches.points(first, second), strict=True):
        np.testing.assert_array_equal(found, wanted)
    distance = np.linalg.norm(cv2.perspectiveTransform(view.points[0][None], view.matrix)[0] - view.points[1], axis=1)
    assert (view.inliers == (distance < 2)).mean() > 0.95


def test_given_matches_are_taken() -> None:
    first, second = described(*plane_points(120, 50))
    matches = Matches.between(first, second)[10:80]
    view = estimate(first, second, "homography", matches=matches)
    assert view is not None
    np.testing.assert_array_equal(view.indices, matches.indices)


def test_the_ratio_and_the_threshold_arrive() -> None:
    first, second = described(*plane_points(120, 0))
    first.descriptors[:60] += 0.97 * first.descriptors[60:]  # nearly as near to another one
    counts = []
    for ratio in (0.9, None):
        view = estimate(first, second, "homography", ratio=ratio)
        assert view is not None
        assert len(view.inliers) == len(Matches.between(first, second, ratio))
        counts.append(len(view.inliers))
    assert counts[0] < 80 < counts[1]
    noisy = plane_points(120, 0)
    noisy[1][:] += np.random.default_rng(4).normal(0, 1.5, noisy[1].shape)
    found = [estimate(*described(*noisy), "homography", threshold=threshold) for threshold in (2.0, 8.0)]
    narrow, wide = (int(view.inliers.sum()) if view else 0 for view in found)
    assert narrow < wide == 120


def test_images_refine_the_matches() -> None:
    image = cv2.GaussianBlur(textured(480, 640), (0, 0), 1.0)
    shift = np.array([109, -86]) / 32  # OpenCV 4 warps in steps of 1/32 pixel
    other = cv2.warpAffine(image, np.array([[1, 0, shift[0]], [0, 1, shift[1]]]), (640, 480), flags=cv2.INTER_CUBIC)
    rng = np.random.default_rng(0)
    first = rng.uniform(30, (610, 450), (150, 2)).round(2)
    second = first + shift + rng.normal(0, 0.7, first.shape)
    features = described(first, second)
    truth = np.array([[1, 0, shift[0]], [0, 1, shift[1]], [0, 0, 1]])
    error = []
    for images in (None, (image, other)):
        view = estimate(*features, "homography", images=images)
        assert view is not None
        assert view.matrix is not None
        corners = np.array([[[0, 0], [639, 0], [639, 479], [0, 479]]], np.float64)
        ends = (cv2.perspectiveTransform(corners, matrix)[0] for matrix in (view.matrix, truth))
        error.append(np.linalg.norm(np.subtract(*ends), axis=1).max())
    assert error[1] < 0.3 * error[0]
    assert error[1] < 0.1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", METHODS)
def test_unrelated_points_have_no_geometry(kind: str, method: str) -> None:
    for count in (0, 3, 5, 8, 30, 300):
        first, second = np.random.default_rng(count).uniform(0, (640, 480), (2, count, 2))
        K = K1 if kind == "essential" else None
        assert estimate(*described(first, second), kind, K, ratio=None, method=method) is None


LINE = np.outer(np.linspace(0, 400, 40), [1, 0.5])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "points", [np.full((40, 2), 7.0), LINE, LINE + np.random.default_rng(0).normal(0, 0.3, LINE.shape), LINE[:1]]
)
def test_points_at_one_place_or_on_one_line_have_no_geometry(kind: str, method: str, points: np.ndarray) -> None:
    assert estimate(*described(points, points + 5), kind, K1 if kind == "essential" else None, method=method) is None


@pytest.mark.parametrize("side", [0, 1])
def test_a_line_in_one_of_the_images_is_enough(side: int) -> None:
    spread = plane_points(40, 0)[0]
    pair = [spread, spread]
    assert estimate(*described(*pair), "homography") is not None
    pair[side] = spread * [1, 0.001]
    assert estimate(*described(*pair), "homography") is None


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", range(9))
def test_a_handful_of_matches_has_a_geometry_only_beyond_what_fixes_it(kind: str, count: int) -> None:
    first, second = plane_points(120, 0) if kind == "homography" else scene_points(120, 0)
    view = estimate(*described(first[:count], second[:count]), kind, K1 if kind == "essential" else None)
    assert view is None or count > {"homography": 4, "fundamental": 7, "essential": 5}[kind]


def test_pictures_of_different_things_have_no_geometry() -> None:
    elf = ElfRuntime(TINY, threads=1)
    found = [elf.detect(textured(240, 320, seed), threshold="none") for seed in range(4)]
    for a, b in combinations(found, 2):
        for kind in KINDS:
            assert estimate(a, b, kind, K1 if kind == "essential" else None, ratio=None) is None


def test_photographs() -> None:
    """Different scenes have no geometry; the views of one have, with the homography that is known."""
    folder = shared("data", "oxford_affine")
    elf = ElfRuntime(threads=1)
    scenes = ("v_graf", "i_leuven", "i_ubc", "v_wall")
    first, second = ([elf.detect(folder / scene / f"{n}.png") for scene in scenes] for n in (1, 2))
    for i, j in combinations(range(len(scenes)), 2):
        for kind in KINDS:
            assert estimate(first[i], first[j], kind, K1 if kind == "essential" else None) is None
    for scene, a, b in zip(scenes, first, second, strict=True):
        images = (folder / scene / "1.png", folder / scene / "2.png")
        truth = np.loadtxt(folder / scene / "H_1_2")
        view = estimate(a, b, "homography", images=images)
        assert view is not None
        assert view.points is not None
        agreeing = view.points[0][view.inliers][None].astype(np.float64)
        ends = [cv2.perspectiveTransform(agreeing, matrix)[0] for matrix in (view.matrix, truth)]
        assert np.median(np.linalg.norm(ends[0] - ends[1], axis=1)) < 1.5, scene


def test_settings_that_do_not_fit() -> None:
    a, b = described(*plane_points(20, 0))
    for wrong, text in (
        ({"kind": "affine"}, "kind is one of .*, not 'affine'"),
        ({"kind": "essential"}, "K, the cameras' calibration, goes with"),
        ({"kind": "homography", "K": K1}, "goes with the kind 'essential'"),
        ({"method": "lmeds"}, "method is one of .*, not 'lmeds'"),
        ({"threshold": 0.0}, "threshold"),
        ({"threshold": float("inf")}, "threshold"),
        ({"confidence": 1.0}, "confidence"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"max_iterations": 10.0}, "max_iterations"),
        ({"ratio": 2.0}, "ratio"),
        ({"matches": np.zeros((3, 2), np.int64)}, r"Matches\.between\(a, b\), not ndarray"),
        (
            {"matches": Matches.between(a, b)[:1], "a": a, "b": described(*plane_points(1, 0))[1]},
            "not of these features",
        ),
        ({"images": textured(9, 9)}, "pair of the first and the second image"),
        ({"a": a.descriptors}, "points are of Features, .* not of ndarray"),
    ):
        with pytest.raises(SettingError, match=text):
            estimate(**{"a": a, "b": b, "kind": "homography", **wrong})
    for K in (np.eye(4), np.stack([K1] * 3), K1.T, np.diag([500.0, -500.0, 1.0]), K1 * np.nan, 2 * K1, "K", [K1, 3]):
        with pytest.raises(SettingError, match="K is a calibration matrix"):
            estimate(a, b, "essential", K)
