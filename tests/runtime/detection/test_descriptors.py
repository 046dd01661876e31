"""Interpolation of descriptors by the network's geometry, against a plain loop."""

from __future__ import annotations

import numpy as np
import pytest

from elf_runtime.detection.descriptors import sample


def plain_sample(fmap: np.ndarray, point: np.ndarray, stride: float, offset: float) -> np.ndarray:
    h, w, _ = fmap.shape
    x, y = (np.asarray(point, np.float64) - offset) / stride
    x, y = min(max(x, 0), w - 1), min(max(y, 0), h - 1)
    total = np.zeros(fmap.shape[2])
    for j in range(h):
        for i in range(w):
            total += max(0, 1 - abs(x - i)) * max(0, 1 - abs(y - j)) * fmap[j, i]
    return total / np.linalg.norm(total)


@pytest.mark.parametrize(("h", "w"), [(6, 9), (1, 4), (5, 1), (1, 1), (2, 2)])
def test_equals_the_plain_loop(h: int, w: int) -> None:
    rng = np.random.default_rng(h * 10 + w)
    fmap = rng.random((h, w, 5)).astype(np.float32)
    points = rng.uniform(-10, 90, (200, 2)).astype(np.float32)
    found = sample(fmap, points, 8.0, 3.5)
    wanted = np.array([plain_sample(fmap, p, 8.0, 3.5) for p in points])
    assert np.abs(found - wanted).max() < 1e-5


def test_a_cell_centre_takes_its_cell() -> None:
    fmap = np.random.default_rng(0).random((4, 4, 3)).astype(np.float32)
    # Stride 16, offset 7.5: the centre of cell i is (16 i + 7.5), so x = (i + 0.5) 16 - 0.5.
    found = sample(fmap, np.array([[2 * 16 + 7.5, 1 * 16 + 7.5]], np.float32), 16.0, 7.5)
    assert np.allclose(found[0], fmap[1, 2] / np.linalg.norm(fmap[1, 2]), atol=1e-6)


def test_rows_have_unit_norm_and_zero_stays_zero() -> None:
    fmap = np.array([[[3, 4], [0, 0], [1e-30, 0]]], np.float32)
    rows = sample(fmap, np.array([[0, 0], [1, 0], [2, 0]], np.float32), 1.0, 0.0)
    assert rows[0] == pytest.approx([0.6, 0.8])
    assert rows[1].tolist() == [0, 0]
    assert np.isfinite(rows).all()
