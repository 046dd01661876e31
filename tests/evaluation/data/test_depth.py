"""Depth maps: what hides a point, and where depth is known."""

from __future__ import annotations

import numpy as np
import pytest

from elf_eval.data.depth import depth_at, through_depth


def test_what_is_hidden_has_no_image():
    k, near, far = (
        np.diag([10.0, 10.0, 1.0]),
        np.full((9, 9), 2.0, np.float32),
        np.full((9, 9), 5.0, np.float32),
    )
    points = np.array([[3.0, 3.0]])
    assert through_depth(points, far, far, k, k, np.eye(4)) == pytest.approx(points)
    assert np.isnan(through_depth(points, far, near, k, k, np.eye(4))).all()
    assert np.isnan(through_depth(points, far * 0, far, k, k, np.eye(4))).all()


@pytest.mark.parametrize(("depth", "seen"), [(4.8, True), (4.7, False), (5.2, True), (5.3, False)])
def test_a_depth_five_percent_off_is_another_thing(depth, seen):
    camera = np.array([[100.0, 0, 20], [0, 100, 15], [0, 0, 1]])
    first, second = (np.full((30, 40), d, np.float32) for d in (5.0, depth))
    found = through_depth(np.array([[10.0, 10.0]]), first, second, camera, camera, np.eye(4))
    assert np.isfinite(found).all() == seen


def test_depth_is_known_on_the_map_and_above_zero_only():
    depth = np.array([[1.0, 2.0, 0.0], [4.0, -5.0, 6.0]], np.float32)
    places = [[0.4, 0.4], [2.4, 1.4], [2.0, 0.0], [1.0, 1.0], [3.0, 0.0], [0.0, 2.0], [-0.6, 0.0], [np.nan, 0.0]]
    np.testing.assert_array_equal(depth_at(depth, np.array(places)), [1.0, 6.0] + [np.nan] * 6)
