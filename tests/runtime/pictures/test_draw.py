"""What users draw, and what notebooks show."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from elf_runtime import (
    ElfRuntime,
    Features,
    ImageError,
    Matches,
    SettingError,
    draw_keypoints,
    draw_matches,
)
from elf_runtime.pictures.render import INLIER, OUTLIER, detection_picture, match_picture
from helpers import TINY, textured

SIZE = (100, 160)


def features(*points: tuple[float, float], size: tuple[int, int] = SIZE) -> Features:
    count = len(points)
    keypoints, scores = np.array(points, np.float32).reshape(-1, 2), np.linspace(200, 10, count, dtype=np.float32)
    return Features(keypoints, scores, np.zeros((count, 0), np.float32), size)


def decoded(png: bytes) -> npt.NDArray[np.uint8]:
    assert png.startswith(b"\x89PNG")
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), np.uint8)


def test_any_image_that_detect_takes_is_drawn_on(tmp_path: Path) -> None:
    image, found = textured(*SIZE), features((40, 30))
    cv2.imwrite(str(tmp_path / "a.png"), image)
    drawn = draw_keypoints(image, found)
    assert (drawn.shape, drawn.dtype) == ((100, 160, 3), np.uint8)
    assert (drawn != draw_keypoints(image, found[:0])).any(axis=2).sum() > 20
    alpha = np.dstack([image, np.zeros(SIZE, np.uint8)])
    for same in (tmp_path / "a.png", str(tmp_path / "a.png"), image.astype(np.uint16) * 257, alpha):
        np.testing.assert_array_equal(draw_keypoints(same, found), drawn)
    np.testing.assert_array_equal(draw_keypoints(image[:, :, ::-1], found, color="rgb"), drawn)
    assert (draw_keypoints(image[:, :, ::-1], found) != drawn).any()


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((100, 150), np.uint8), r"^the image is 150x100, that of the features 160x100$"),
        (np.zeros(SIZE, np.int64), "int64"),
        (np.full(SIZE, np.nan), "NaN"),
        (np.zeros(100, np.uint8), "shape"),
        ("absent.png", "^absent.png: "),
        (None, "NoneType"),
    ],
)
def test_other_images(image: Any, message: str) -> None:
    with pytest.raises(ImageError, match=message):
        draw_keypoints(image, features((40, 30)))
    with pytest.raises(ImageError, match=message):
        draw_matches(textured(*SIZE), features(), image, features(), [])


def test_a_file_of_another_size_is_named(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(50, 60))
    with pytest.raises(ImageError, match=r"a\.png: the image is 60x50, that of the features 160x100$"):
        draw_keypoints(tmp_path / "a.png", features())


def test_what_are_no_features() -> None:
    with pytest.raises(SettingError, match="not of ndarray"):
        draw_keypoints(textured(*SIZE), np.zeros((3, 2)))  # type: ignore[arg-type]
    with pytest.raises(SettingError, match="color is"):
        draw_keypoints(textured(*SIZE), features(), color="gray")


A, B = features((20, 20), (80, 50), (140, 80)), features((30, 90), (150, 10), size=(120, 200))
PAIRS = np.array([[2, 0], [0, 1]])


def test_matches_are_drawn_from_point_to_point() -> None:
    images = textured(*SIZE), textured(120, 200, seed=1)
    points = np.float32([[140, 80], [20, 20]]), np.float32([[30, 90], [150, 10]])
    inliers = np.array([True, False])
    titles = (("", "3 keypoints, 2 matches, 1 inliers"), ("", "2 keypoints"))
    drawn = draw_matches(images[0], A, images[1], B, PAIRS, inliers)
    np.testing.assert_array_equal(drawn, match_picture(images, points, inliers, titles))
    for color in (INLIER, OUTLIER):
        assert (np.abs(drawn.astype(int) - color).max(axis=2) < 40).any()
    matches = Matches(PAIRS, np.ones(2, np.float32), np.ones(2, np.float32))
    plain = draw_matches(images[0], A, images[1], B, matches)
    np.testing.assert_array_equal(plain, draw_matches(images[0], A, images[1], B, PAIRS.tolist()))
    assert (plain != drawn).any()
    assert draw_matches(images[0], A, images[1], B, []).shape == drawn.shape


@pytest.mark.parametrize(
    ("pairs", "inliers", "message"),
    [
        (PAIRS[:, ::-1], None, r"matches up to \(1, 2\) are not of these features, 3 and 2"),
        (PAIRS - 1, None, "below 0"),
        (PAIRS.astype(float), None, "integers"),
        (PAIRS[0], None, "integers"),
        (PAIRS, [True], "inliers are 2 booleans"),
        (PAIRS, [0, 1], "inliers are 2 booleans"),
    ],
)
def test_matches_that_do_not_fit(pairs: Any, inliers: Any, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        draw_matches(textured(*SIZE), A, textured(120, 200), B, pairs, inliers)


@pytest.fixture
def photograph(tmp_path: Path) -> Path:
    cv2.imwrite(str(tmp_path / "a.png"), textured(120, 160))
    return tmp_path / "a.png"


def test_a_notebook_shows_keypoints_on_their_image(photograph: Path) -> None:
    found = ElfRuntime(TINY, threads=1).detect(photograph)[:5]
    shown = decoded(found._repr_png_())
    large = cv2.resize(textured(120, 160), None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    moved = replace(found, keypoints=(found.keypoints + 0.5) * 2 - 0.5, image_size=(240, 320))
    np.testing.assert_array_equal(shown[30:], draw_keypoints(large, moved))


@pytest.mark.parametrize("change", ["gone", "other", "no image", "no digest", "another size"])
def test_a_notebook_shows_a_blank_canvas_where_the_image_is_not_there(photograph: Path, change: str) -> None:
    found = ElfRuntime(TINY, threads=1).detect(photograph)[:5]
    blank = decoded(replace(found, record=None)._repr_png_())
    assert (blank[30:] == blank[-1, -1]).all(axis=2).mean() > 0.95
    record = dict(found.record or {})
    if change == "gone":
        photograph.unlink()
    elif change == "other":
        cv2.imwrite(str(photograph), textured(120, 160, seed=1))
    elif change == "no image":
        photograph.write_text("text")
        record["image_sha256"] = hashlib.sha256(b"text").hexdigest()
    elif change == "no digest":
        record["image"] = 3
    else:
        cv2.imwrite(str(photograph), textured(60, 80))
        del record["image_sha256"]
    np.testing.assert_array_equal(decoded(replace(found, record=record)._repr_png_()), blank)


def test_a_canvas_is_no_larger_than_a_panel() -> None:
    shown = decoded(features((5e5, 5e5), size=(10**6, 10**6))._repr_png_())
    assert shown.shape == (830, 800, 3)
    ring = np.argwhere((shown[30:] != shown[-1, -1]).any(axis=2))
    np.testing.assert_allclose(ring.mean(axis=0), (400, 400), atol=0.5)
    assert len(ring) < 200
    assert decoded(features(size=(1, 10**6))._repr_png_()).shape == (31, 800, 3)


def test_a_notebook_shows_a_trace_s_maps(photograph: Path) -> None:
    trace = ElfRuntime(TINY, threads=1).trace(photograph)
    np.testing.assert_array_equal(decoded(trace._repr_png_()), detection_picture(textured(120, 160), trace))
    photograph.unlink()
    assert decoded(trace._repr_png_()).shape == detection_picture(textured(120, 160), trace).shape
