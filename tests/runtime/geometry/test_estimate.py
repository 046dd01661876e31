"""Geometry between the features of two images: of planes and scenes that are known, and settings that are wrong."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import Matches, SettingError, estimate
from elf_runtime.geometry.fit import METHODS
from helpers import textured

from .scenes import ALONG, HOMOGRAPHY, K1, K2, TURN, described, plane_points, scene_points


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


def test_settings_that_do_not_fit() -> None:
    a, b = described(*plane_points(20, 0))
    for wrong, text in (
        ({"kind": "affine"}, "kind is one of .*, not 'affine'"),
        ({"kind": "essential"}, "needs K, the cameras' calibration"),
        ({"kind": "essential", "K": K1[:2]}, r"pair of them, .* not array\(.*\)$"),
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
