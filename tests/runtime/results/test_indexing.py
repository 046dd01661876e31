"""Features by index and by filters, against Python's lists."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from elf_runtime import Features, ImageError, SettingError

from .scattered import scattered

COLUMNS = ("keypoints", "scores", "descriptors", "sizes", "angles")


def assert_rows(found: Features, features: Features, rows: list[int]) -> None:
    for name in COLUMNS:
        values = getattr(features, name)
        np.testing.assert_array_equal(
            getattr(found, name), np.array([values[i] for i in rows]).reshape(-1, *values.shape[1:])
        )
    assert (found.image_size, found.nms_radius, found.record) == (features.image_size, 4.0, features.record)


@pytest.mark.parametrize(
    ("index", "rows"),
    [
        (2, [2]),
        (-1, [6]),
        (np.int64(3), [3]),
        (slice(1, 6, 2), [1, 3, 5]),
        (slice(None, None, -1), [6, 5, 4, 3, 2, 1, 0]),
        (slice(9, 12), []),
        ([4, 4, 0], [4, 4, 0]),
        ([], []),
        (np.array([-1, 1]), [6, 1]),
        (np.array([True, False, False, True, False, False, True]), [0, 3, 6]),
    ],
)
def test_an_index_is_numpy_s(index: Any, rows: list[int]) -> None:
    features = scattered(7)
    assert_rows(features[index], features, rows)


@pytest.mark.parametrize("index", [7, -8, 1.0, "0", None, [[0, 1]], [0, 7], np.ones(6, np.bool_), (0, 1)])
def test_what_is_no_index(index: Any) -> None:
    with pytest.raises(IndexError):
        scattered(7)[index]


def test_they_can_be_gone_through() -> None:
    features = scattered(5)
    assert [float(one.scores[0]) for one in features] == features.scores.tolist()
    assert [len(one) for one in features] == [1] * 5


def test_the_strongest() -> None:
    features = scattered(7)
    shuffled = features[[3, 0, 6, 1, 5, 2, 4]]
    assert_rows(shuffled.strongest(3), features, [0, 1, 2])
    assert_rows(shuffled.strongest(100), features, list(range(7)))
    assert len(features.strongest(0)) == 0
    for count in (-1, 1.5, True, None):
        with pytest.raises(SettingError, match="count is an integer >= 0"):
            features.strongest(count)  # type: ignore[arg-type]


def test_inside_a_mask() -> None:
    features = scattered(200)
    mask = np.random.default_rng(1).integers(0, 2, (60, 80)).astype(np.bool_)
    rows = []
    for i, (x, y) in enumerate(features.keypoints.tolist()):
        column, row = min(max(round(x), 0), 79), min(max(round(y), 0), 59)
        if mask[row, column]:
            rows.append(i)
    assert 50 < len(rows) < 150
    assert_rows(features.inside(mask), features, rows)
    assert_rows(features.inside(mask.astype(np.uint8) * 255), features, rows)
    assert len(features.inside(np.zeros((60, 80), np.uint8))) == 0
    for wrong in (mask.T, mask.astype(np.float32)):
        with pytest.raises(ImageError, match="mask"):
            features.inside(wrong)


def test_a_place_beyond_the_image_is_at_its_edge() -> None:
    features = Features(
        np.array([[-3, 4], [99, 4]], np.float32), np.ones(2, np.float32), np.zeros((2, 0), np.float32), (6, 10)
    )
    mask = np.zeros((6, 10), np.bool_)
    mask[4, 9] = True
    assert features.inside(mask).keypoints.tolist() == [[99, 4]]
