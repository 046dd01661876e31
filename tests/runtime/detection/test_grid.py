"""Keypoints spread over a grid: a level and a share for each cell."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from elf_runtime import DetectionParams, ElfRuntime
from elf_runtime.detection.grid import cells, passing_by_cell, shared_out
from elf_runtime.detection.threshold import scores_and_mask
from helpers import ROOT, textured


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime(threads=1)


@pytest.fixture(scope="module")
def shaded() -> npt.NDArray[np.uint8]:
    """A view whose right half lies in shade."""
    picture = np.asarray(cv2.imread(str(ROOT / "demo" / "palace.jpg")), np.uint8)
    picture[:, 320:] = ((picture[:, 320:].astype(float) - 128) * 0.15 + 100).clip(0, 255)
    return picture


def by_a_loop(points: np.ndarray, shape: tuple[int, int], grid: tuple[int, int], limit: int) -> list[int]:
    """Oracle: go through the cells one by one."""
    share = max(1, limit // len(list(cells(shape, grid))))
    first: list[int] = []
    for rows, columns in cells(shape, grid):
        inside = [
            i for i, (x, y) in enumerate(points)
            if rows.start <= y < rows.stop and columns.start <= x < columns.stop
        ]  # fmt: skip
        first += inside[:share]
    first.sort()
    rest = [i for i in range(len(points)) if i not in first]
    return sorted((first + rest)[:limit])


@pytest.mark.parametrize("seed", range(12))
def test_shares_are_those_of_a_plain_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(int(n) for n in rng.integers(1, 60, 2))
    grid = tuple(int(n) for n in rng.integers(1, 9, 2))
    count, limit = int(rng.integers(0, 200)), int(rng.integers(0, 120))
    points = np.stack([rng.integers(0, shape[1], count), rng.integers(0, shape[0], count)], axis=1)
    scores = np.sort(rng.random(count).astype(np.float32))[::-1]
    kept, strength = shared_out(points, scores, shape, grid, limit)  # type: ignore[arg-type]
    index = by_a_loop(points, shape, grid, limit)  # type: ignore[arg-type]
    np.testing.assert_array_equal(kept, points[index])
    np.testing.assert_array_equal(strength, scores[index])


@pytest.mark.parametrize("shape", [(7, 5), (1, 1), (40, 41)])
@pytest.mark.parametrize("grid", [(1, 1), (3, 4), (50, 2)])
def test_cells_tile_the_map(shape: tuple[int, int], grid: tuple[int, int]) -> None:
    count = np.zeros(shape, int)
    for cell in cells(shape, grid):
        assert count[cell].size > 0
        count[cell] += 1
    assert (count == 1).all()


def test_each_cell_is_thresholded_as_an_image_of_its_own() -> None:
    saliency = textured(48, 64)[:, :, 0].astype(np.float32) / 7
    saliency[:, 32:] *= 0.01
    params = DetectionParams(grid=(2, 2), normalize=0.95)
    found = passing_by_cell(saliency, params)
    for cell in cells((48, 64), (2, 2)):
        np.testing.assert_array_equal(found[cell], scores_and_mask(saliency[cell].copy(), params)[1])
    assert found[:, 32:].mean() > 0.02


def test_a_shaded_half_gets_its_share(elf: ElfRuntime, shaded: np.ndarray) -> None:
    strongest, spread = elf.detect(shaded), elf.detect(shaded, grid=(4, 4))
    assert (strongest.keypoints[:, 0] >= 320).sum() < 80
    assert (spread.keypoints[:, 0] >= 320).sum() > 120
    assert len(spread) > len(strongest)
    assert (np.diff(spread.scores) <= 0).all()
    chebyshev = np.abs(spread.keypoints[:, None] - spread.keypoints).max(axis=2) + 1e9 * np.eye(len(spread))
    assert chebyshev.min() > 4  # suppression goes across the cells' borders


def test_a_grid_of_one_cell_is_no_grid(elf: ElfRuntime, shaded: np.ndarray) -> None:
    np.testing.assert_array_equal(elf.detect(shaded, grid=(1, 1)).keypoints, elf.detect(shaded).keypoints)


def test_cells_finer_than_pixels_and_the_paper_s_settings(elf: ElfRuntime, shaded: np.ndarray) -> None:
    assert len(elf.detect(shaded, grid=(1000, 1000))) > 0
    assert len(elf.detect(shaded, grid=(3, 3), preset="paper")) > 100
