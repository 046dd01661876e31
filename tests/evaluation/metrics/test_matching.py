"""Descriptor distances and mutual nearest neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from elf_eval.metrics.matching import descriptor_distances, mutual_nearest
from elf_runtime.checks.greedy import greedy_matching


def test_greedy_is_not_mutual_nearest_neighbours():
    # 0-0 goes first; 1-1 is nobody's first choice and must still be taken.
    distance = np.array([[1.0, 2.0], [2.0, 9.0]])
    assert greedy_matching(distance).tolist() == [[0, 0], [1, 1]]
    assert mutual_nearest(distance).tolist() == [[0, 0]]


def test_descriptor_distances(rng):
    a, b = rng.normal(size=(7, 16)).astype(np.float32), rng.normal(size=(5, 16)).astype(np.float32)
    expected = np.linalg.norm(a[:, None].astype(float) - b[None].astype(float), axis=2)
    assert descriptor_distances(a, b) == pytest.approx(expected, abs=1e-12)
    x, y = (rng.integers(0, 256, (n, 32), np.uint8) for n in (6, 9))
    bits = [[sum((int(p) ^ int(q)).bit_count() for p, q in zip(u, v, strict=True)) for v in y] for u in x]
    assert descriptor_distances(x, y).tolist() == bits
