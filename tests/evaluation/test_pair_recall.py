"""benchmarks/pair_recall.py: recall against plain loops, and points where the true cameras see them."""

from __future__ import annotations

import runpy

import cv2
import numpy as np
import pytest

from helpers import ROOT

SCRIPT = runpy.run_path(str(ROOT / "benchmarks" / "pair_recall.py"))


def test_recall_against_plain_loops() -> None:
    sequences = np.array(["a", "a", "b", "b", "b", "a"])
    rows = np.random.default_rng(0).standard_normal((6, 5)) + 2.0
    shares = []
    for i in range(6):
        cosines = []
        for j in range(6):
            a, b = rows[i] - rows.mean(axis=0), rows[j] - rows.mean(axis=0)
            if j != i:
                cosines.append((-(a @ b) / np.linalg.norm(a) / np.linalg.norm(b), j))
        shares.append(sum(sequences[j] == sequences[i] for _, j in sorted(cosines)[:2]) / 2)
    assert SCRIPT["sequence_recall"](rows, sequences) == pytest.approx(100 * np.mean(shares))
    assert 0 < np.mean(shares) < 1
    groups = np.eye(2)[(sequences == "a").astype(int)]
    assert SCRIPT["sequence_recall"](groups, sequences) == 100


def test_points_are_where_they_were_and_wrong_matches_are_left_out() -> None:
    rng = np.random.default_rng(1)
    scene = rng.uniform((-2, -2, 6), (2, 2, 9), (40, 3))
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    poses = [np.eye(4), np.eye(4)]
    poses[1][:3, :3] = cv2.Rodrigues(np.array([0.05, -0.1, 0.02]))[0]
    poses[1][:3, 3] = (1.0, 0.2, 0.1)
    rows = rng.standard_normal((40, 32)).astype(np.float32)
    views = []
    for pose in poses:
        seen = (scene @ pose[:3, :3].T + pose[:3, 3]) @ K.T
        places = seen[:, :2] / seen[:, 2:]
        if len(views) == 1:
            places[:10] += 40 * rng.choice([-1, 1], (10, 2))
        views.append(([cv2.KeyPoint(float(x), float(y), 1.0) for x, y in places], rows, (480, 640)))
    found = SCRIPT["triangulated"](*views, *((K, pose) for pose in poses))
    right = [np.linalg.norm(scene - point, axis=1).min() for point in found]
    assert 30 <= len(found) <= 33  # a wrong one may lie along its line
    assert np.sort(right)[:30].max() < 1e-3
