"""The pooled descriptor of an image against plain loops, and which images are nearest by it."""

from __future__ import annotations

import numpy as np
import pytest

from elf_runtime import Features, SettingError, global_descriptor
from elf_runtime.results.global_descriptor import nearest


def unit_rows(count: int, dim: int, seed: int = 0) -> np.ndarray:
    rows = np.random.default_rng(seed).standard_normal((count, dim))
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def fourth_root(matrix: np.ndarray) -> np.ndarray:
    """By Newton's iteration for the square root, twice: no eigenvectors.  Denman, Beavers (1976)."""
    for _ in range(2):
        y, z = matrix, np.eye(len(matrix))
        for _ in range(60):
            y, z = (y + np.linalg.inv(z)) / 2, (z + np.linalg.inv(y)) / 2
        matrix = y
    return matrix


def test_it_is_the_fourth_root_of_the_covariance() -> None:
    rows = unit_rows(60, 5)
    mean = [sum(float(row[i]) for row in rows) / 60 for i in range(5)]
    covariance = np.zeros((5, 5))
    for i in range(5):
        for j in range(5):
            covariance[i, j] = sum((float(r[i]) - mean[i]) * (float(r[j]) - mean[j]) for r in rows) / 60
    root = fourth_root(covariance)
    np.testing.assert_allclose(np.linalg.matrix_power(root, 4), covariance, atol=1e-12)
    wanted = [root[i, j] * (1 if i == j else 2**0.5) for i in range(5) for j in range(i, 5)]
    found = global_descriptor(rows)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, np.array(wanted) / np.linalg.norm(wanted), atol=1e-6)


def test_products_are_cosines_between_the_matrices() -> None:
    a, b = (unit_rows(40, 6, seed) for seed in (1, 2))
    matrices = [fourth_root(np.cov(rows.T.astype(np.float64), bias=True)) for rows in (a, b)]
    cosine = (matrices[0] * matrices[1]).sum() / np.linalg.norm(matrices[0]) / np.linalg.norm(matrices[1])
    assert global_descriptor(a) @ global_descriptor(b) == pytest.approx(cosine, abs=1e-6)


def test_features_of_any_order_and_of_few_keypoints() -> None:
    rows = unit_rows(90, 16)
    pooled = global_descriptor(rows)
    features = Features(np.zeros((90, 2), np.float32), np.ones(90, np.float32), rows[::-1].copy(), (48, 64))
    np.testing.assert_allclose(global_descriptor(features), pooled, atol=1e-6)
    for few in (rows[:0], rows[:1], np.repeat(rows[:1], 7, axis=0)):
        np.testing.assert_array_equal(global_descriptor(few), np.zeros(136, np.float32))
    # As many directions as keypoints less one: rounding adds none to them.
    two = rows[:2].astype(np.float64)
    across = (two[0] - two[1]) / np.linalg.norm(two[0] - two[1])
    upper = np.triu_indices(16)
    wanted = np.outer(across, across)[upper] * np.where(upper[0] == upper[1], 1, 2**0.5)
    np.testing.assert_allclose(global_descriptor(rows[:2]), wanted, atol=1e-6)


def test_wide_descriptors_are_projected_and_stay_alike() -> None:
    a = unit_rows(300, 160, 3)
    moved = a + 0.02 * unit_rows(300, 160, 4)
    pooled = [global_descriptor(rows) for rows in (a, moved, unit_rows(300, 160, 5) ** 3)]
    assert pooled[0].shape == (8256,)
    assert pooled[0] @ pooled[1] > 0.99 > pooled[0] @ pooled[2]
    np.testing.assert_array_equal(pooled[0], global_descriptor(a))


def test_nearest_against_plain_loops() -> None:
    pooled = np.random.default_rng(6).standard_normal((12, 9)) + 3.0
    mean = pooled.mean(axis=0)
    for count in (1, 4, 11, 50):
        found = nearest(pooled, count)
        for i in range(12):
            a = pooled[i] - mean
            cosines = []
            for j in range(12):
                b = pooled[j] - mean
                if j != i:
                    cosines.append((-(a @ b) / np.sqrt(a @ a) / np.sqrt(b @ b), j))
            assert found[i].tolist() == [j for _, j in sorted(cosines)][:count]


def test_ties_go_by_index_and_one_image_has_no_other() -> None:
    assert [row.tolist() for row in nearest(np.ones((4, 3)), 2)] == [[1, 2], [0, 2], [0, 1], [0, 1]]
    assert [row.tolist() for row in nearest(np.ones((1, 3)), 2)] == [[]]


def test_what_is_refused() -> None:
    with pytest.raises(SettingError, match="from 1 on, not 0"):
        nearest(np.ones((3, 2)), 0)
    with pytest.raises(SettingError, match="--desc none"):
        global_descriptor(np.zeros((4, 0), np.float32))
    with pytest.raises(SettingError, match="NaN"):
        global_descriptor(np.full((4, 3), np.nan, np.float32))
