"""Descriptor distances and mutual nearest neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from elf_eval.metrics.matching import descriptor_distances, mutual_nearest
from elf_runtime import match
from elf_runtime.checks.greedy import greedy_matching


def test_greedy_is_not_mutual_nearest_neighbours():
    # 0-0 goes first; 1-1 is nobody's first choice and must still be taken.
    distance = np.array([[1.0, 2.0], [2.0, 9.0]])
    assert greedy_matching(distance).tolist() == [[0, 0], [1, 1]]
    assert mutual_nearest(distance).tolist() == [[0, 0]]


@pytest.mark.parametrize("ratio", [0.6, 0.8, 0.95])
def test_the_ratio_test_is_that_of_the_runtime_and_of_plain_loops(ratio, rng):
    a, b = rng.normal(size=(40, 8)), rng.normal(size=(60, 8))
    distance = descriptor_distances(a, b)
    kept = []
    for i, j in mutual_nearest(distance).tolist():
        nearest, second = sorted(float(d) for d in distance[i])[:2]
        assert nearest == distance[i, j]
        if nearest < ratio * second:
            kept.append([i, j])
    assert 0 < len(kept) < len(mutual_nearest(distance))
    assert mutual_nearest(distance, ratio).tolist() == kept == match(a, b, ratio).tolist()


def test_a_single_column_passes_the_ratio_test_and_nothing_gives_nothing():
    assert mutual_nearest(np.array([[3.0], [2.0]]), 0.5).tolist() == [[1, 0]]
    assert mutual_nearest(np.zeros((0, 5)), 0.5).shape == (0, 2)


def test_descriptor_distances(rng):
    a, b = rng.normal(size=(7, 16)).astype(np.float32), rng.normal(size=(5, 16)).astype(np.float32)
    expected = np.linalg.norm(a[:, None].astype(float) - b[None].astype(float), axis=2)
    assert descriptor_distances(a, b) == pytest.approx(expected, abs=1e-12)
    x, y = (rng.integers(0, 256, (n, 32), np.uint8) for n in (6, 9))
    bits = [[sum((int(p) ^ int(q)).bit_count() for p, q in zip(u, v, strict=True)) for v in y] for u in x]
    assert descriptor_distances(x, y).tolist() == bits
