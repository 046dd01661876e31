"""The vectorised greedy non-maximum suppression equals the plain loop, exactly."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elf_runtime.detection import nms
from elf_runtime.detection.nms import greedy_nms, window_maxima

Array = npt.NDArray[np.number]


def plain_loop(scores: Array, mask: npt.NDArray[np.bool_], radius: int) -> list[tuple[int, int]]:
    """The definition: by descending score, ties in raster order, each taken candidate clears its window."""
    height, width = scores.shape
    candidates = [(y, x) for y in range(height) for x in range(width) if mask[y, x]]
    candidates.sort(key=lambda p: (-float(scores[p]), p))
    alive = mask.copy()
    taken = []
    for y, x in candidates:
        if alive[y, x]:
            taken.append((x, y))
            alive[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1] = False
    return taken


def check(scores: Array, mask: npt.NDArray[np.bool_], radius: int, limit: int | None = None) -> None:
    points, values = greedy_nms(scores, mask, radius, limit)
    assert [tuple(p) for p in points.tolist()] == plain_loop(scores, mask, radius)[:limit]
    assert values.tolist() == [scores[y, x] for x, y in points]
    assert points.dtype == np.int64
    assert values.dtype == scores.dtype


@settings(max_examples=300, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 40), st.integers(0, 6),
    st.sampled_from([2, 5, 50, 0]), st.floats(0.0, 1.0), st.none() | st.integers(0, 60),
    st.sampled_from([1, 64, 10**9]), st.sampled_from([1, 1 << 20]),
)  # fmt: skip
def test_equals_the_plain_loop(
    seed: int, h: int, w: int, radius: int, levels: int, density: float, limit: int | None, dense: int, block: int
) -> None:
    """Whatever the ties and the limit, by dilations or around single candidates, in one piece or many."""
    rng = np.random.default_rng(seed)
    raw = rng.random((h, w)) if levels == 0 else rng.integers(0, levels, (h, w))  # few levels: many ties
    mask = rng.random((h, w)) < density
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("elf_runtime.detection.nms._DENSE", dense)
        patch.setattr("elf_runtime.detection.nms._BLOCK", block)
        check(raw.astype(np.float32), mask, radius, limit)


@settings(max_examples=100, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(0, 4), st.sampled_from([2, 20, 256]), st.floats(0.0, 1.0),
    st.none() | st.integers(0, 60), st.sampled_from([1, 64, 10**9]),
)  # fmt: skip
def test_eight_bits(seed: int, radius: int, levels: int, density: float, limit: int | None, dense: int) -> None:
    """As numbers they have nothing below 0 to mark what is no candidate, and no negative to sort by."""
    rng = np.random.default_rng(seed)
    scores = rng.integers(0, levels, (30, 40), np.uint8)
    mask = (rng.random(scores.shape) < density) & (scores > 0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("elf_runtime.detection.nms._DENSE", dense)
        check(scores, mask, radius, limit)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 7), st.none() | st.integers(0, 60))
def test_smooth_maps_with_plateaus(seed: int, radius: int, levels: int, limit: int | None) -> None:
    """As a blurred 8-bit map is: hills whose tops are cut off."""
    raw = np.random.default_rng(seed).random((40, 50)).astype(np.float32)
    hills = cv2.normalize(cv2.GaussianBlur(raw, (9, 9), 2.0), None, 0.0, levels, cv2.NORM_MINMAX)
    scores = np.floor(hills)
    check(scores, scores > 0, radius, limit)


@pytest.mark.parametrize("radius", [0, 1, 3, 10])
def test_plateaus_ramps_and_stripes(radius: int) -> None:
    y, x = np.mgrid[:30, :45].astype(np.float32)
    everywhere = np.ones((30, 45), np.bool_)
    for scores in (np.ones((30, 45), np.float32), x, y, x + y, x % 7, (x + 3 * y) % 5, -x, 45 * y + x):
        check(scores.astype(np.float32), everywhere, radius)


@pytest.mark.parametrize("limit", [None, 40])
def test_large_plateaus_are_numbered(monkeypatch: pytest.MonkeyPatch, limit: int | None) -> None:
    calls = []
    numbered = nms._numbered
    monkeypatch.setattr(nms, "_numbered", lambda *given: calls.append(1) or numbered(*given))
    rng = np.random.default_rng(0)
    check(np.ones((40, 50), np.float32), rng.random((40, 50)) < 0.9, 3, limit)
    check(rng.integers(0, 4, (60, 50)).astype(np.float32), np.ones((60, 50), np.bool_), 2, limit)
    check(rng.integers(1, 5, (60, 50), np.uint8), np.ones((60, 50), np.bool_), 2, limit)
    assert len(calls) == 3
    check(rng.random((60, 50)).astype(np.float32), np.ones((60, 50), np.bool_), 2, limit)
    assert len(calls) == 3


@pytest.mark.parametrize("radius", [0, 1, 2, 5])
@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (7, 7), (23, 31)])
def test_distinct_scores_are_never_numbered(
    monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], radius: int
) -> None:
    monkeypatch.delattr(nms, "_numbered")
    lattice = -(np.arange(shape[0])[:, None] % (radius + 1) + np.arange(shape[1]) % (radius + 1)) * 10.0**6
    distinct = lattice + np.arange(lattice.size).reshape(shape)  # as many peaks as can be
    check(distinct, np.ones(shape, np.bool_), radius)


def test_a_tie_goes_to_raster_order_and_its_loser_may_win_elsewhere() -> None:
    scores = np.zeros((1, 9), np.float32)
    scores[0, [1, 3, 5]] = 1.0  # 1 clears 3, so 5 is taken too
    points, _ = greedy_nms(scores, scores > 0, 2)
    assert points.tolist() == [[1, 0], [5, 0]]


def test_an_off_by_one_window_would_be_seen() -> None:
    scores = np.zeros((1, 30), np.float32)
    scores[0, [5, 15, 26]] = [3, 2, 1]
    points, _ = greedy_nms(scores, scores > 0, 10)
    assert points.tolist() == [[5, 0], [26, 0]]  # 15 is exactly 10 away from 5; 26 is 11 away from 15


def test_limit_keeps_the_strongest() -> None:
    scores = np.random.default_rng(0).random((60, 60)).astype(np.float32)
    mask = np.ones(scores.shape, np.bool_)
    every, _ = greedy_nms(scores, mask, 3)
    some, values = greedy_nms(scores, mask, 3, limit=7)
    assert some.tolist() == every[:7].tolist()
    assert (np.diff(values) <= 0).all()
    assert len(greedy_nms(scores, mask, 3, limit=0)[0]) == 0


def test_an_equal_candidate_that_is_no_peak_itself_goes_first() -> None:
    """(1, 0) is highest of what its window still holds, but (0, 0), equal and earlier, is yet to be decided."""
    scores = np.array([[5, 5, 9, 9, 9]], np.float32)[:, ::-1].copy()
    check(scores, np.ones(scores.shape, np.bool_), 1)
    check(np.array([[0, 1, 0, 0], [1, 1, 0, 0]], np.float32), np.ones((2, 4), np.bool_), 1)


def test_scores_at_the_limit_are_kept_in_raster_order() -> None:
    scores = np.zeros((3, 40), np.float32)
    scores[2, [5, 15, 25]] = 2.0
    scores[0, 35] = 2.0
    scores[1, 20] = 1.0
    check(scores, scores > 0, 3, limit=3)


@pytest.mark.parametrize("shape", [(6, 9), (9, 6), (1, 5)])
def test_a_radius_beyond_the_map_costs_no_more(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int]) -> None:
    scores = np.random.default_rng(0).random(shape).astype(np.float32)
    sides = []
    frame = nms._Frame
    monkeypatch.setattr(nms, "_Frame", lambda *given: sides.append(given[2]) or frame(*given))
    for radius in (max(shape) - 2, max(shape) - 1, max(shape), 100_000, 10**20):
        points, _ = greedy_nms(scores, scores > 0, radius)
        if radius >= max(shape) - 1:
            assert points.tolist() == [[scores.argmax() % shape[1], scores.argmax() // shape[1]]]
        else:
            check(scores, scores > 0, radius)
    assert max(sides) == max(shape) - 1


@pytest.mark.parametrize("limit", [None, 0, 5])
def test_nothing_in_nothing_out(limit: int | None) -> None:
    points, values = greedy_nms(np.zeros((8, 8), np.float32), np.zeros((8, 8), np.bool_), 2, limit)
    assert points.shape == (0, 2)
    assert values.shape == (0,)


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
@pytest.mark.parametrize("radius", [0, 1, 3, 40])
def test_window_maxima_equal_the_plain_loop(radius: int, dtype: type) -> None:
    scores = np.random.default_rng(radius).integers(0, 9, (23, 31)).astype(dtype)
    wanted = [
        [scores[y, x] == scores[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1].max()
         for x in range(31)]
        for y in range(23)
    ]  # fmt: skip
    np.testing.assert_array_equal(window_maxima(scores, radius), wanted)
