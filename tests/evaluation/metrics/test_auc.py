"""Areas under recall curves, in both conventions."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from elf_eval.metrics.auc import auc, auc_trapezoids


def test_auc_is_the_area_under_the_recall_curve(rng):
    errors = rng.uniform(0, 8, 200)
    steps = np.linspace(0, 5, 100001)
    recall = (errors[:, None] <= steps[None, ::100]).mean(axis=0)
    assert np.mean([auc(e, 5) for e in errors]) == pytest.approx(recall.mean(), abs=2e-3)
    assert auc(math.inf, 5) == 0.0
    assert auc(0.0, 5) == 1.0


def superglue_auc(errors, threshold):
    """The trapezoids of the published figures, pair by pair."""
    points, area = [(0.0, 0.0)], 0.0
    for rank, error in enumerate(sorted(errors), start=1):
        if error >= threshold:
            break
        points.append((error, rank / len(errors)))
    points.append((threshold, points[-1][1]))
    for (x0, y0), (x1, y1) in pairwise(points):
        area += (x1 - x0) * (y0 + y1) / 2
    return area / threshold


def test_auc_by_trapezoids_is_that_of_a_loop(rng):
    for size in (1, 2, 7, 50):
        errors = [*rng.uniform(0, 12, size).tolist(), math.inf]
        for threshold in (1, 5, 10):
            assert auc_trapezoids(errors, threshold) == pytest.approx(superglue_auc(errors, threshold), abs=1e-12)


def test_the_two_conventions_of_auc_by_hand():
    """Errors 2 and 12 degrees, up to 10: steps give (10 - 2) / 10 / 2, trapezoids half a triangle more."""
    assert np.mean([auc(2.0, 10), auc(12.0, 10)]) == pytest.approx(0.4)
    assert auc_trapezoids([2.0, 12.0], 10) == pytest.approx(0.4 + 2.0 * 0.5 / 2 / 10)
    assert auc_trapezoids([math.inf, 30.0], 10) == 0.0
