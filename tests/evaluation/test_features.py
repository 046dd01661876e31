"""Local features."""

from __future__ import annotations

import numpy as np

from elf_eval.features import LocalFeatures


def test_features_are_sorted_with_ties_in_their_order():
    found = LocalFeatures.build([[0, 0], [1, 1], [2, 2]], [1, 2, 2])
    assert found.keypoints.tolist() == [[1, 1], [2, 2], [0, 0]]
    points = np.arange(200.0).reshape(100, 2)
    found = LocalFeatures.build(points, np.arange(100) % 2)
    np.testing.assert_array_equal(found.keypoints, np.concatenate([points[1::2], points[::2]]))
