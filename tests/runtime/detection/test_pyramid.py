"""Suppression and shares across working scales, against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from elf_runtime.detection import pyramid
from elf_runtime.detection.pyramid import Candidates, merged


def candidates(seed: int, counts: tuple[int, ...], span: int, cells: int = 1, levels: int = 40) -> list[Candidates]:
    """Keypoints on quarters of a pixel, so that some distances are the radius itself, with many equal scores."""
    rng = np.random.default_rng(seed)
    return [
        Candidates(
            (rng.integers(-2, 4 * span, (count, 2)) / 4).astype(np.float32),
            np.sort(rng.integers(0, levels, count))[::-1].astype(np.float32),
            1.0 / 2**number,
            rng.integers(0, cells, count),
            cells,
        )
        for number, count in enumerate(counts)
    ]


def plain_loop(levels: list[Candidates], radius: int, limit: int) -> list[tuple[int, int]]:
    """(level, index) of what is kept, one keypoint after the other."""
    everyone = [(n, i) for n, level in enumerate(levels) for i in range(len(level.scores))]

    def order(one: tuple[int, int]) -> tuple[float, int, float, float]:
        x, y = levels[one[0]].places[one[1]].tolist()
        return -float(levels[one[0]].scores[one[1]]), one[0], y, x

    taken: list[tuple[int, int]] = []
    for n, i in sorted(everyone, key=order):
        place = levels[n].places[i].astype(float)
        if not any(m != n and np.abs(levels[m].places[j] - place).max() <= radius for m, j in taken):
            taken.append((n, i))
    total = sum(level.scale for level in levels)
    room = {
        (n, cell): max(1, round(limit * level.scale / total) // level.cells)
        for n, level in enumerate(levels)
        for cell in range(level.cells)
    }
    within, others = [], []
    for n, i in taken:
        group = (n, int(levels[n].cell[i]))
        room[group] -= 1
        (within if room[group] >= 0 else others).append((n, i))
    kept = set((within + others)[:limit])
    return [one for one in taken if one in kept]


@pytest.mark.parametrize("radius", [0, 1, 3, 50])
@pytest.mark.parametrize("counts", [(60, 40, 20), (50, 0, 30), (0, 0), (7, 90), (30, 20, 20, 10, 10)])
@pytest.mark.parametrize("limit", [0, 1, 5, 40, 1000])
def test_equals_the_plain_loop(radius: int, counts: tuple[int, ...], limit: int) -> None:
    for seed in range(3):
        given = candidates(seed, counts, 30)
        level, index = merged(given, radius, limit)
        assert list(zip(level.tolist(), index.tolist(), strict=True)) == plain_loop(given, radius, limit)


def test_the_cells_of_a_grid_share_a_level_s_part() -> None:
    for seed in range(5):
        given = candidates(seed, (80, 60, 40), 100, cells=6)
        level, index = merged(given, 2, 60)
        assert list(zip(level.tolist(), index.tolist(), strict=True)) == plain_loop(given, 2, 60)


def test_shares_are_in_proportion_to_the_scales() -> None:
    given = candidates(0, (800, 800, 800), 10_000)
    level, _ = merged(given, 0, 700)
    assert np.bincount(level).tolist() == [400, 200, 100]
    few = [given[0], *candidates(1, (0, 30), 10_000)[1:], given[2]]
    level, _ = merged(few, 0, 700)
    assert np.bincount(level)[1] == 30
    assert len(level) == 700


def test_one_level_suppresses_nothing_of_itself() -> None:
    (given,) = candidates(0, (50,), 5)
    level, index = merged([given], 50, 1000)
    assert sorted(index.tolist()) == list(range(50))
    assert not level.any()


def test_a_keypoint_beyond_the_radius_stays() -> None:
    """The window is a square whose border belongs to it."""

    def at(*places: tuple[float, float]) -> list[Candidates]:
        none = np.zeros(1, np.int64)
        return [
            Candidates(np.array([place], np.float32), np.array([9.0 - n], np.float32), 1.0, none, 1)
            for n, place in enumerate(places)
        ]

    assert len(merged(at((10, 10), (16, 16)), 6, 9)[0]) == 1
    assert len(merged(at((10, 10), (16, 16.25)), 6, 9)[0]) == 2
    # The second one is gone when the third is asked for.
    assert len(merged(at((10, 10), (15, 10), (20, 10)), 6, 9)[0]) == 2


def test_many_keypoints_are_compared_with_their_neighbours_only(monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = []
    real = np.repeat
    monkeypatch.setattr(pyramid.np, "repeat", lambda *given: pairs.append(out := real(*given)) or out)
    merged(candidates(0, (5000, 5000), 3000), 6, 1000)
    assert max(map(len, pairs)) < 20_000
