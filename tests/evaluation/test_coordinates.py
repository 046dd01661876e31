"""Pixel coordinates."""

from __future__ import annotations

import numpy as np
import pytest

from elf_eval.coordinates import inside, resize_matrix, warp

SIZE1, SIZE2 = (60, 40), (50, 45)


def test_points_behind_the_horizon_are_dropped():
    matrix = np.array([[1.0, 0, 0], [0, 1, 0], [-0.1, 0, 1]])  # the line x = 10 goes to infinity
    warped = warp(matrix, [[5.0, 5.0], [10.0, 5.0], [15.0, 5.0]])
    assert np.isfinite(warped[0]).all()
    assert np.isnan(warped[1:]).all()
    assert not inside(warped, SIZE1)[1:].any()


def test_inside_spans_whole_pixels():
    points = np.array([[-0.5, 0], [-0.51, 0], [59.49, 39.49], [59.5, 0], [0, 39.5]])
    assert inside(points, SIZE1).tolist() == [True, False, True, False, False]


def test_resizing_keeps_the_images_edges_together():
    matrix = resize_matrix((1000, 700), (640, 480))
    assert warp(matrix, [[-0.5, -0.5], [999.5, 699.5]]) == pytest.approx(np.array([[-0.5, -0.5], [639.5, 479.5]]))
