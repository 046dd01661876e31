"""The picture of a reconstructed scene."""

from __future__ import annotations

import numpy as np
import pytest

from elf_runtime.pictures.canvas import DARK
from elf_runtime.pictures.scene import scene_picture

PANEL, TITLE = 800, 30
RED, BLUE = (255, 0, 0), (0, 0, 255)


def half(picture: np.ndarray, right: bool) -> np.ndarray:
    return picture[TITLE:, -PANEL:] if right else picture[TITLE:, :PANEL]


def places(panel: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """x and y of the pixels that are more red, or more blue, than anything else is."""
    strongest = panel[:, :, {RED: 2, BLUE: 0}[color]].astype(int) - panel[:, :, 1]
    return np.argwhere(strongest > 100)[:, ::-1]


def drawn(turn: np.ndarray) -> np.ndarray:
    """Red points to the left, high and far, blue ones to the right, low and near; one camera in the middle."""
    rng = np.random.default_rng(0)
    left = rng.normal((-2, -1, 6), 0.05, (60, 3))
    right = rng.normal((2, 1, 4), 0.05, (60, 3))
    colors = np.repeat(np.array([RED, BLUE], np.uint8), 60, axis=0)
    return scene_picture(np.concatenate([left, right]) @ turn, colors, turn[None], np.zeros((1, 3)), "a", "b")


@pytest.mark.parametrize("turn", [np.eye(3), np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])])
def test_the_two_views_are_from_above_and_along_the_camera(turn: np.ndarray) -> None:
    picture = drawn(turn)
    above, ahead = half(picture, False), half(picture, True)
    (x_red, far), (x_blue, near) = (places(above, color).mean(axis=0) for color in (RED, BLUE))
    assert x_red < x_blue - 300
    assert far < near - 50  # what is farther is higher up
    (x_red, high), (x_blue, low) = (places(ahead, color).mean(axis=0) for color in (RED, BLUE))
    assert x_red < x_blue - 300
    assert high < low - 150


def test_cameras_are_drawn_where_they_are() -> None:
    above = half(drawn(np.eye(3)), False)
    green = np.argwhere(above[:, :, 1].astype(int) - above[:, :, 2] > 80)[:, ::-1]
    assert len(green) > 50
    x, y = green.mean(axis=0)
    red, blue = (places(above, color).mean(axis=0) for color in (RED, BLUE))
    assert abs(x - (red[0] + blue[0]) / 2) < 20
    assert y > blue[1] + 100


def test_few_points_far_off_do_not_shrink_the_rest() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform((-1, -1, 3), (1, 1, 5), (1000, 3))
    points[:3] = ((500, 0, 0), (0, -500, 0), (0, 0, 500))
    colors = np.full((1000, 3), 200, np.uint8)
    picture = half(scene_picture(points, colors, np.eye(3)[None], np.zeros((1, 3)), ""), True)
    x = np.argwhere((picture == 200).all(axis=2))[:, 1]
    assert np.ptp(x) > 600


def test_a_scene_without_points_and_cameras_that_look_all_ways_are_drawn() -> None:
    none = scene_picture(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.eye(3)[None], np.zeros((1, 3)), "")
    assert (none != DARK).any()
    around = np.stack([np.eye(3), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1]), np.diag([1.0, -1, -1])])
    points = np.random.default_rng(0).uniform(-5, 5, (50, 3))
    picture = scene_picture(points, np.full((50, 3), 99, np.uint8), around, np.eye(4)[:, :3], "")
    assert picture.dtype == np.uint8
    assert (picture != DARK).any()
