"""Mutual nearest neighbours against a plain loop."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from elf_runtime import Features, SettingError, match


def unit_rows(rows: np.ndarray) -> np.ndarray:
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def unit(n: int, d: int, seed: int) -> np.ndarray:
    return unit_rows(np.random.default_rng(seed).standard_normal((n, d)))


def plain(a: np.ndarray, b: np.ndarray, ratio: float | None) -> list[list[int]]:
    pairs = []
    for i, row in enumerate(a):
        ab = [float(np.linalg.norm(row - other)) for other in b]
        j = int(np.argmin(ab))
        back = int(np.argmin([float(np.linalg.norm(b[j] - other)) for other in a]))
        passes = ratio is None or len(b) < 2 or sorted(ab)[0] < ratio * sorted(ab)[1]
        if back == i and passes:
            pairs.append([i, j])
    return pairs


@pytest.mark.parametrize("band", [512, 7])
@pytest.mark.parametrize("ratio", [None, 0.8, 0.95])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 7), (7, 1), (30, 20), (40, 41), (42, 36)])
def test_equals_the_plain_loop(n: int, m: int, ratio: float | None, band: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("elf_runtime.results.matching._BAND", band)
    a, b = unit(n, 16, 1), unit(m, 16, 2)
    b[: min(n, m) // 2] = unit_rows(a[: min(n, m) // 2] + 0.1 * b[: min(n, m) // 2])
    assert match(a, b, ratio).tolist() == plain(a, b, ratio)


@pytest.mark.parametrize("band", [512, 2])
def test_ties_go_to_the_lower_index(band: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("elf_runtime.results.matching._BAND", band)
    x, y, z = np.eye(3, dtype=np.float32)
    assert match(np.stack([z, x, x, y, x, y]), np.stack([y, x, y, y, x])).tolist() == [[1, 1], [3, 0]]


def test_two_candidates_are_enough_for_the_ratio() -> None:
    near = np.array([[1.0, 0.0], [0.8, 0.6]], np.float32)
    assert match(near[:1], near, ratio=0.9).tolist() == [[0, 0]]
    between = np.array([[0.96, 0.28]], np.float32)
    assert match(between, near).tolist() == [[0, 0]]
    assert match(between, near, ratio=0.5).tolist() == []


def test_two_equal_candidates_fail_the_ratio() -> None:
    """Both at distance 0, or, by float32's rounding, at a square just below it."""
    rows = unit(64, 7, 0)
    assert ((rows * rows).sum(axis=1) > 1.0).any()
    exact = np.array([[0.0, 1.0]], np.float32)
    for row in (exact, *rows[:, None]):
        twice = np.concatenate([row, row])
        assert match(row, twice).tolist() == [[0, 0]]
        assert match(row, twice, ratio=0.9).tolist() == []


def test_the_ratio_is_to_the_second_nearest_of_many() -> None:
    a, b = unit(300, 8, 1), unit(700, 8, 2)
    near = np.sort(np.linalg.norm(a[:, None].astype(np.float64) - b[None], axis=2), axis=1)
    mutual = match(a, b)
    wanted = [pair for pair in mutual.tolist() if near[pair[0], 0] < 0.9 * near[pair[0], 1]]
    assert 10 < len(wanted) < len(mutual)
    assert match(a, b, ratio=0.9).tolist() == wanted


def test_the_nearest_may_be_more_than_a_right_angle_away() -> None:
    a = np.array([[1.0, 0.0], [0.6, 0.8]], np.float32)
    assert match(a, np.array([[-1.0, 0.0]], np.float32)).tolist() == [[1, 0]]


def test_the_table_of_all_products_is_never_whole_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("elf_runtime.results.matching._BAND", 64)
    a, b = unit(3000, 8, 1), unit(3000, 8, 2)
    tracemalloc.start()
    match(a, b, ratio=0.9)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3000 * 3000 * 4 / 3


def test_features_and_empty_sides() -> None:
    nothing = Features(np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros((0, 16), np.float32), (9, 9))
    assert match(nothing, unit(3, 16, 0)).shape == (0, 2)
    assert match(unit(3, 16, 0), nothing).shape == (0, 2)


@pytest.mark.parametrize("ratio", [None, 0.8])
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.float16, np.int32, np.uint16])
def test_rows_of_any_length_go_by_their_distance(dtype: type, ratio: float | None) -> None:
    rng = np.random.default_rng(0)
    a = rng.uniform(0, 100, (60, 16)) * rng.uniform(0.1, 3, (60, 1))
    b = np.concatenate([a[:40][::-1] + rng.uniform(0, 20, (40, 16)), rng.uniform(0, 200, (25, 16))])
    a, b = a.astype(dtype), b.astype(dtype)
    wanted = plain(a.astype(np.float64), b.astype(np.float64), ratio)
    assert len(wanted) > 20
    assert match(a, b, ratio).tolist() == wanted


def test_a_row_far_from_unit_length_is_nearest_to_itself() -> None:
    rows = unit(200, 32, 0) * np.geomspace(1e-3, 1e3, 200, dtype=np.float32)[:, None]
    assert match(rows, rows).tolist() == [[i, i] for i in range(200)]


def test_doubles_are_compared_as_doubles() -> None:
    rng = np.random.default_rng(0)
    a = rng.uniform(0, 1, (50, 16)) + 1e6
    b = a[::-1] + rng.uniform(0, 1e-3, (50, 16))
    assert match(a, b).tolist() == plain(a, b, None) == [[i, 49 - i] for i in range(50)]


def test_bits_and_transposed_arrays_are_refused() -> None:
    with pytest.raises(SettingError, match=r"the second side is of uint8: .*NORM_HAMMING"):
        match(unit(3, 32, 0), np.ones((3, 32), np.uint8))
    columns = unit(40, 16, 0).T
    with pytest.raises(SettingError, match=r"the first side .* shape \(16, 40\) looks like \(D, N\)"):
        match(columns, columns)
    standardised = np.random.default_rng(0).standard_normal((2000, 8))
    standardised = (standardised - standardised.mean(axis=0)) / standardised.std(axis=0)
    assert match(standardised, standardised).tolist() == [[i, i] for i in range(2000)]
    for shape in ((16,), (2, 3, 16)):
        with pytest.raises(SettingError, match="can't be compared"):
            match(np.ones(shape, np.float32), unit(3, 16, 0))


def test_what_cannot_be_compared() -> None:
    with pytest.raises(SettingError, match="can't be compared"):
        match(unit(3, 16, 0), unit(3, 8, 0))
    for ratio in (0.0, 1.0, -0.5, 1.5, float("nan")):
        with pytest.raises(SettingError, match="ratio"):
            match(unit(3, 16, 0), unit(3, 16, 0), ratio=ratio)
    with pytest.raises(SettingError, match=r"ratio is a number in .*, not '0.9'"):
        match(unit(3, 16, 0), unit(3, 16, 0), ratio="0.9")  # type: ignore[arg-type]
    odd = unit(3, 16, 0)
    for value in (np.nan, np.inf):
        odd[1, 2] = value
        with pytest.raises(SettingError, match="some descriptors of the first side are NaN, infinite or too large"):
            match(odd, unit(3, 16, 0))
        with pytest.raises(SettingError, match="some descriptors of the second side are NaN, infinite or too large"):
            match(unit(3, 16, 0), odd)
    with pytest.raises(SettingError, match="the second side is Features or an"):
        match(unit(3, 16, 0), "b")  # type: ignore[arg-type]
    for other in (None, unit(3, 16, 0).astype(object), unit(3, 16, 0) * 1j):
        with pytest.raises(SettingError, match=r"the first side is Features or an .* of (object|complex)"):
            match(other, unit(3, 16, 0))  # type: ignore[arg-type]
    with pytest.raises(SettingError, match="infinite"):
        match(np.full((1, 16), 1e300), unit(3, 16, 0))
    with pytest.raises(SettingError, match="no descriptors"):
        match(np.zeros((2, 0), np.float32), np.zeros((2, 0), np.float32))
