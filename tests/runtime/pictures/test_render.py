"""Pictures: their size, and that each thing is drawn where it belongs."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from elf_runtime import Features, Level, Trace
from elf_runtime.pictures.canvas import side_by_side, strength_colors, titled
from elf_runtime.pictures.render import (
    INLIER,
    OUTLIER,
    PASSED,
    detection_picture,
    displayable,
    draw_keypoints,
    draw_mask,
    heatmap,
    match_picture,
)


def features(points: list[tuple[float, float]], size: tuple[int, int] = (100, 160)) -> Features:
    count = len(points)
    scores = np.linspace(200, 10, count).astype(np.float32)
    keypoints = np.array(points, np.float32).reshape(-1, 2)
    return Features(keypoints, scores, np.zeros((count, 4), np.float32), size)


@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 1), (20, 30, 3), (20, 30, 4)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.bool_])
def test_every_image_the_runtime_takes_is_displayable(shape: tuple[int, ...], dtype: type) -> None:
    top = {np.uint8: 255, np.uint16: 65535, np.float32: 1.0, np.bool_: True}[dtype]
    shown = displayable(np.full(shape, top, dtype))
    assert shown.shape == (20, 30, 3)
    assert shown.dtype == np.uint8
    assert (shown == 255).all()


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_cameras_of_fewer_bits_fill_the_range(bits: int, channels: int) -> None:
    ramp = np.linspace(0, (1 << bits) - 1, 256).astype(np.uint16).reshape(16, 16, 1).repeat(channels, axis=2)
    if channels == 4:
        ramp[:, :, 3] = 65535  # alpha says nothing of the bits
    shown = displayable(ramp)[:, :, 0].ravel().astype(int)
    assert np.abs(shown - np.arange(256)).max() <= 1
    assert (shown[0], shown[-1]) == (0, 255)


def test_a_dark_picture_of_16_bits_stays_dark() -> None:
    values = np.full((16, 16), 100, np.uint16)
    values[0, 0] = 40000
    assert displayable(values)[5, 5, 0] == 0
    assert displayable(values)[0, 0, 0] == 40000 >> 8


@pytest.mark.parametrize("kind", ["u2", "f4"])
def test_any_byte_order_is_displayable(kind: str) -> None:
    values = (np.arange(600) * (100 if kind == "u2" else 1 / 600)).astype(kind).reshape(20, 30)
    for order in "<>":
        np.testing.assert_array_equal(displayable(values.astype(order + kind)), displayable(values))


def test_a_heatmap_rises_and_clips_outliers() -> None:
    ramp = np.linspace(0, 1, 1000, dtype=np.float32).reshape(10, 100)
    ramp[9, 99] = 1e6
    brightness = cv2.cvtColor(heatmap(ramp), cv2.COLOR_BGR2GRAY).astype(int).ravel()
    assert brightness[0] < 5
    assert brightness[900] > 180
    assert (np.diff(brightness[::50]) > 0).all()


def test_a_heatmap_of_nothing_is_dark() -> None:
    assert heatmap(np.zeros((8, 8), np.float32)).max() < 10


def test_rings_lie_around_their_keypoints() -> None:
    image = np.zeros((100, 160, 3), np.uint8)
    drawn = draw_keypoints(image, features([(40, 30), (120, 70)]))
    touched = np.argwhere((drawn > 60).any(axis=2))
    for x, y in ((40, 30), (120, 70)):
        near = np.abs(touched - (y, x)).max(axis=1) <= 7
        assert near.any()
        np.testing.assert_allclose(touched[near].mean(axis=0), (y, x), atol=0.25)
    assert all(np.abs(touched - p).max(axis=1).min() <= 7 for p in ((30, 40), (70, 120)))
    assert image.max() == 0  # the caller's image is left alone


def test_rings_grow_with_sizes() -> None:
    found = replace(features([(60, 60), (140, 60)], (120, 200)), sizes=np.array([13, 39], np.float32))
    drawn = draw_keypoints(np.zeros((120, 200), np.uint8), found)
    widths = [np.ptp(np.flatnonzero(drawn[60, part].any(axis=1))) for part in (slice(40, 80), slice(110, 170))]
    assert 1.5 * widths[0] < widths[1] < 3 * widths[0]


def test_strong_is_yellow_and_weak_is_violet() -> None:
    strong, *_, weak = strength_colors(10)
    assert strong[2] > 200
    assert strong[1] > 200
    assert weak[0] > weak[1]
    assert strength_colors(0) == []


def test_the_mask_is_drawn_where_it_passes() -> None:
    mask = np.zeros((50, 80), np.bool_)
    mask[10:20, 30:40] = True
    drawn = draw_mask(np.full((100, 160), 128, np.uint8), mask)
    assert (drawn[22:38, 62:78] == PASSED).all()
    assert (drawn[:18] < 60).all()


@pytest.mark.parametrize("size", [(100, 160), (1000, 300), (33, 47)])
def test_a_detection_picture_has_three_equal_panels(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (*size, 3), np.uint8)
    work = (size[0] // 2, size[1] // 2)
    found = features([(5, 5), (20, 30)], size)
    level = Level(0.5, rng.random(work, np.float32), rng.random(work, np.float32), rng.random(work) > 0.5)
    trace = Trace(found, (level,))
    picture = detection_picture(image, trace, "name.png")
    assert picture.dtype == np.uint8
    assert (picture.shape[1] - 12) % 3 == 0
    longest = max(picture.shape[0] - 30, (picture.shape[1] - 12) // 3)
    assert 200 <= longest <= 800


def test_a_detection_without_keypoints_has_a_picture() -> None:
    zero = np.zeros((64, 64), np.float32)
    trace = Trace(features([], (64, 64)), (Level(1.0, zero, zero, zero > 0),))
    assert detection_picture(np.zeros((64, 64), np.uint8), trace).ndim == 3


def test_match_lines_join_the_matched_points() -> None:
    images = [np.zeros((240, 420, 3), np.uint8)] * 2
    points = [np.array([[100, 60], [100, 200]], np.float32), np.array([[300, 60], [300, 200]], np.float32)]
    picture = match_picture(images, points, np.array([True, False]))
    left, top = 420 + 6, 30
    assert picture.shape == (240 + top, 2 * 420 + 6, 3)
    for (x, y), color in (((100, 60), INLIER), ((left + 300, 60), INLIER), ((100, 200), OUTLIER)):
        np.testing.assert_array_equal(picture[y + top, x], color)
    middle = picture[60 + top, 300]
    assert middle[1] > middle[0]
    assert middle[1] > middle[2]
    assert picture[130 + top, 300].max() == 0


def test_a_large_and_a_small_image_are_matched_in_one_picture() -> None:
    images = [np.zeros((1200, 1600, 3), np.uint8), np.zeros((64, 64), np.uint8)]
    points = [np.array([[1599, 1199]], np.float32), np.array([[0, 0]], np.float32)]
    picture = match_picture(images, points)
    assert picture.shape[0] == 630
    assert picture[30:, :800].max() > 100  # the line reaches the scaled image's corner


def test_no_matches_is_a_picture_too() -> None:
    none = np.zeros((0, 2), np.float32)
    assert match_picture([np.zeros((300, 400), np.uint8)] * 2, [none, none]).shape == (330, 806, 3)


def test_a_long_title_is_cut_to_the_picture() -> None:
    assert titled(np.zeros((10, 90, 3), np.uint8), "a title that has no room here").shape == (40, 90, 3)


@pytest.mark.parametrize("width", [120, 200, 800])
def test_a_long_name_leaves_room_for_the_counts(width: int) -> None:
    """The strip shows the end of the name and the whole counts, as a strip that has room for everything draws them."""
    name = "folder/" + "x" * 300 + ".png"
    strip = titled(np.zeros((10, width, 3), np.uint8), name, "500 kpts")[:30]
    texts = ["", *("..." + name[i:] for i in range(1, len(name)))]
    roomy = [titled(np.zeros((10, 4000, 3), np.uint8), text, "500 kpts")[:30] for text in texts]
    fitting = [drawn[:, :width] for drawn in roomy if last_ink(drawn) < width]
    assert any(np.array_equal(strip, drawn) for drawn in fitting)
    assert last_ink(strip) > width - 40


def last_ink(strip: npt.NDArray[np.uint8]) -> int:
    return int(np.flatnonzero((strip > 60).any(axis=(0, 2))).max())


@pytest.mark.parametrize("name", ["not\udcff\udcfeutf", "tab\tand\x1b[31m", "\u6c34", "\x00"])
def test_any_name_can_be_drawn(name: str) -> None:
    assert titled(np.zeros((10, 300, 3), np.uint8), name, "5 keypoints").shape == (40, 300, 3)


def test_side_by_side_keeps_every_picture() -> None:
    white = np.full((10, 20, 3), 255, np.uint8)
    row = side_by_side([white, np.full((30, 5, 3), 200, np.uint8)])
    assert row.shape == (30, 31, 3)
    assert (row[:10, :20] == 255).all()
    assert (row[:, 26:] == 200).all()
