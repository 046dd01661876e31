"""Descriptors in 8 bits: the map, its way back, matches and files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ElfError, Features, Matches, SettingError, estimate, match

from .scattered import scattered


def test_the_map_is_the_documented_one() -> None:
    features = scattered(9, 24)
    found = features.quantized()
    for row, bytes_ in zip(features.descriptors.tolist(), found.descriptors.tolist(), strict=True):
        assert bytes_ == [min(max(round(128 + 192 * x), 0), 255) for x in row]
    assert found.descriptors.dtype == np.uint8
    assert found.descriptors.nbytes * 4 == features.descriptors.nbytes
    assert found.quantized() is found
    assert found.keypoints is features.keypoints
    assert found.record is features.record


def test_what_is_too_large_is_cut_off_and_zeros_stay() -> None:
    rows = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 0]], np.float32)
    features = Features(np.zeros((3, 2), np.float32), np.ones(3, np.float32), rows, (20, 30)).quantized()
    assert features.descriptors.tolist() == [[255, 128, 128], [128, 0, 128], [128, 128, 128]]
    assert match(features[:2], features[:2]).tolist() == [[0, 0], [1, 1]]
    assert match(features, features).tolist() == [[0, 0], [1, 1], [2, 2]]


def test_rows_of_another_length_are_refused() -> None:
    rows = np.full((2, 4), 0.6, np.float32)
    features = Features(np.zeros((2, 2), np.float32), np.ones(2, np.float32), rows, (20, 30))
    with pytest.raises(SettingError, match="unit length"):
        features.quantized()
    assert scattered(4, 0).quantized().descriptors.shape == (4, 0)
    assert scattered(0).quantized().descriptors.shape == (0, 16)


@pytest.fixture
def pair() -> tuple[Features, Features]:
    """Descriptors of 128 values and noisy ones of the same things."""
    a = scattered(80, 128)
    noisy = a.descriptors + np.random.default_rng(1).normal(0, 0.03, a.descriptors.shape)
    rows = (noisy / np.linalg.norm(noisy, axis=1, keepdims=True)).astype(np.float32)
    return a, Features(a.keypoints, a.scores, rows, a.image_size)


def test_matches_and_similarities_are_those_of_the_floats(pair: tuple[Features, Features]) -> None:
    a, b = pair
    expected = Matches.between(a, b)
    for first, second in ((a.quantized(), b.quantized()), (a, b.quantized()), (a.quantized(), b)):
        assert match(first, second).tolist() == match(a, b).tolist() == [[i, i] for i in range(80)]
        found = Matches.between(first, second)
        cosines = np.sum(a.descriptors[found.indices[:, 0]] * b.descriptors[found.indices[:, 1]], axis=1)
        np.testing.assert_allclose(found.similarity, cosines, atol=5e-3)
        assert sorted(found.indices.tolist()) == sorted(expected.indices.tolist())
    view = estimate(a.quantized(), b.quantized(), "homography")
    assert view is not None
    np.testing.assert_allclose(view.matrix / view.matrix[2, 2], np.eye(3), atol=1e-3)


def test_opencv_takes_the_bytes_and_finds_distances_in_units_of_192(pair: tuple[Features, Features]) -> None:
    a, b = pair
    found = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(a.quantized().to_cv2()[1], b.quantized().to_cv2()[1])
    assert [(m.queryIdx, m.trainIdx) for m in found] == [(i, i) for i in range(80)]
    distances = np.linalg.norm(a.descriptors - b.descriptors, axis=1)
    np.testing.assert_allclose([m.distance / 192 for m in found], distances, rtol=0, atol=0.01)


def test_bytes_that_are_no_features_are_refused_still(pair: tuple[Features, Features]) -> None:
    with pytest.raises(SettingError, match=r"uint8: bits.*Features\.quantized as Features$"):
        match(pair[0].quantized().descriptors, pair[1].quantized().descriptors)


def test_files_keep_the_bytes(tmp_path: Path) -> None:
    features = scattered(9).quantized()
    features.save(tmp_path / "f.npz")
    found = Features.load(tmp_path / "f.npz")
    assert found.descriptors.dtype == np.uint8
    np.testing.assert_array_equal(found.descriptors, features.descriptors)


def test_bytes_of_another_map_are_refused(tmp_path: Path) -> None:
    scattered(9).quantized().save(tmp_path / "f.npz")
    arrays = dict(np.load(tmp_path / "f.npz"))
    np.savez(tmp_path / "other.npz", **{**arrays, "quantization": np.array([256, 128])})
    np.savez(tmp_path / "bits.npz", **{name: values for name, values in arrays.items() if name != "quantization"})
    with pytest.raises(ElfError, match=r"other\.npz: not a feature file: .*scale and zero"):
        Features.load(tmp_path / "other.npz")
    with pytest.raises(ElfError, match=r"bits\.npz: not a feature file: descriptors is of uint8"):
        Features.load(tmp_path / "bits.npz")
