"""Matches that support no geometry: of different scenes, at one place, on one line, too few."""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime, estimate
from elf_runtime.geometry.fit import METHODS
from helpers import TINY, shared, textured

from .scenes import K1, KINDS, described, plane_points, scene_points


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", METHODS)
def test_unrelated_points_have_no_geometry(kind: str, method: str) -> None:
    for count in (0, 3, 5, 8, 30, 300):
        first, second = np.random.default_rng(count).uniform(0, (640, 480), (2, count, 2))
        K = K1 if kind == "essential" else None
        assert estimate(*described(first, second), kind, K, ratio=None, method=method) is None


LINE = np.outer(np.linspace(0, 400, 40), [1, 0.5])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "points", [np.full((40, 2), 7.0), LINE, LINE + np.random.default_rng(0).normal(0, 0.3, LINE.shape), LINE[:1]]
)
def test_points_at_one_place_or_on_one_line_have_no_geometry(kind: str, method: str, points: np.ndarray) -> None:
    assert estimate(*described(points, points + 5), kind, K1 if kind == "essential" else None, method=method) is None


@pytest.mark.parametrize("side", [0, 1])
def test_a_line_in_one_of_the_images_is_enough(side: int) -> None:
    spread = plane_points(40, 0)[0]
    pair = [spread, spread]
    assert estimate(*described(*pair), "homography") is not None
    pair[side] = spread * [1, 0.001]
    assert estimate(*described(*pair), "homography") is None


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", range(9))
def test_a_handful_of_matches_has_a_geometry_only_beyond_what_fixes_it(kind: str, count: int) -> None:
    first, second = plane_points(120, 0) if kind == "homography" else scene_points(120, 0)
    view = estimate(*described(first[:count], second[:count]), kind, K1 if kind == "essential" else None)
    assert view is None or count > {"homography": 4, "fundamental": 7, "essential": 5}[kind]


def test_pictures_of_different_things_have_no_geometry() -> None:
    elf = ElfRuntime(TINY, threads=1)
    found = [elf.detect(textured(240, 320, seed), threshold="none") for seed in range(4)]
    for a, b in combinations(found, 2):
        for kind in KINDS:
            assert estimate(a, b, kind, K1 if kind == "essential" else None, ratio=None) is None


def test_photographs() -> None:
    """Different scenes have no geometry; the views of one have, with the homography that is known."""
    folder = shared("data", "oxford_affine")
    elf = ElfRuntime(threads=1)
    scenes = ("v_graf", "i_leuven", "i_ubc", "v_wall")
    first, second = ([elf.detect(folder / scene / f"{n}.png") for scene in scenes] for n in (1, 2))
    for i, j in combinations(range(len(scenes)), 2):
        for kind in KINDS:
            assert estimate(first[i], first[j], kind, K1 if kind == "essential" else None) is None
    for scene, a, b in zip(scenes, first, second, strict=True):
        images = (folder / scene / "1.png", folder / scene / "2.png")
        truth = np.loadtxt(folder / scene / "H_1_2")
        view = estimate(a, b, "homography", images=images)
        assert view is not None
        assert view.points is not None
        agreeing = view.points[0][view.inliers][None].astype(np.float64)
        ends = [cv2.perspectiveTransform(agreeing, matrix)[0] for matrix in (view.matrix, truth)]
        assert np.median(np.linalg.norm(ends[0] - ends[1], axis=1)) < 1.5, scene
