"""Repeatability and matching score against plain loops, on random and degenerate inputs."""

from __future__ import annotations

import math

import loops
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elf_eval.coordinates import warp
from elf_eval.metrics.matching import descriptor_distances
from elf_runtime.checks.greedy import greedy_matching
from elf_runtime.checks.repeatability import covisible, repeatability_and_matching_score

# Few distinct values: most of these matrices are full of ties.
matrices = st.tuples(st.integers(0, 7), st.integers(0, 7)).flatmap(
    lambda shape: st.lists(
        st.lists(st.sampled_from([0.0, 1.0, 1.5, 2.0, 7.0, math.nan]), min_size=shape[1], max_size=shape[1]),
        min_size=shape[0],
        max_size=shape[0],
    ).map(lambda rows: np.array(rows, np.float64).reshape(shape))
)


@given(matrices, st.sampled_from([1.5, 2.0, math.inf]))
@settings(max_examples=300, deadline=None)
def test_greedy_is_the_plain_loop_and_symmetric(distance, limit):
    pairs = greedy_matching(distance, limit)
    assert [tuple(p) for p in pairs.tolist()] == loops.greedy(distance.tolist(), limit)
    swapped = greedy_matching(distance.T, limit)
    assert {(i, j) for j, i in swapped.tolist()} == {tuple(p) for p in pairs.tolist()}


def test_greedy_on_a_chain_takes_as_many_rounds_as_there_are_links():
    # Every point's nearest neighbour prefers the next one: only one pair is mutual in each round.
    x = np.cumsum(np.arange(40, 0, -1.0))
    distance = np.abs(x[0::2, None] - x[None, 1::2])
    assert [tuple(p) for p in greedy_matching(distance).tolist()] == loops.greedy(distance.tolist())


SIZE1, SIZE2 = (60, 40), (50, 45)


H = np.array([[0.9, 0.1, 3.0], [-0.08, 1.1, 2.0], [1e-3, -5e-4, 1.0]])


def rep_and_ms(p1, p2, d1, d2, matrix, size1=SIZE1, size2=SIZE2, eps=5.0):
    inverse = np.linalg.inv(matrix)
    seen = covisible(p1, p2, lambda p: warp(matrix, p), lambda p: warp(inverse, p), size1, size2)
    distance = descriptor_distances(d1, d2)[np.ix_(seen.first, seen.second)]
    return repeatability_and_matching_score(seen, distance, eps)[:2]


def features(rng, n, size, grid=False):
    points = rng.uniform(-3, [size[0] + 3, size[1] + 3], (n, 2)).astype(np.float32)
    return (np.rint(points) if grid else points), rng.integers(0, 4, (n, 5)).astype(np.float32)


def seen_again(rng, points, descriptors, n):
    """The first n of some features, moved a little and described a little differently."""
    moved = points[:n] + rng.integers(-3, 4, (len(points[:n]), 2))
    return moved.astype(np.float32), descriptors[:n] + rng.integers(0, 2, (len(points[:n]), 5)).astype(np.float32)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("grid", [False, True], ids=["anywhere", "whole pixels"])
def test_rep_and_ms_are_the_plain_loops(seed, grid):
    rng = np.random.default_rng(seed)
    p1, d1 = features(rng, int(rng.integers(0, 60)), SIZE1, grid)
    p2, d2 = features(rng, int(rng.integers(0, 60)), SIZE2, grid)
    warped = np.nan_to_num(warp(H, p1), nan=-9.0).astype(np.float32)
    again, d_again = seen_again(rng, np.rint(warped) if grid else warped, d1, 20)
    p2, d2 = np.concatenate([p2, again]), np.concatenate([d2, d_again])
    expected = loops.rep_and_ms(p1, p2, d1, d2, H, np.linalg.inv(H), SIZE1, SIZE2, 5.0)
    assert rep_and_ms(p1, p2, d1, d2, H) == pytest.approx(expected, abs=0), f"seed {seed}"


@pytest.mark.parametrize("seed", range(5))
def test_rep_and_ms_are_symmetric_under_the_identity(seed):
    rng = np.random.default_rng(seed)
    p1, d1 = features(rng, 50, SIZE1, grid=True)
    p2, d2 = seen_again(rng, p1, d1, 40)
    one = rep_and_ms(p1, p2, d1, d2, np.eye(3), SIZE1, SIZE1)
    assert one == rep_and_ms(p2, p1, d2, d1, np.eye(3), SIZE1, SIZE1), f"seed {seed}"
    assert 0 < one[1] < one[0] < 1


NONE, ONE = np.zeros((0, 2), np.float32), np.array([[20.0, 20.0]], np.float32)


@pytest.mark.parametrize(
    ("p1", "p2", "expected"),
    [
        (NONE, NONE, (0, 0)),
        (NONE, ONE, (0, 0)),
        (ONE, ONE, (1, 1)),
        (ONE, ONE + np.float32([5, 0]), (1, 1)),
        (ONE, ONE + np.float32([5.01, 0]), (0, 0)),
        (ONE + 100, ONE, (0, 0)),
        (ONE + 100, ONE + 100, (0, 0)),
        # Three copies of a point repeat one point once, and min(3, 1) = 1.
        (np.repeat(ONE, 3, 0), ONE, (1, 1)),
        (np.repeat(ONE, 3, 0), np.repeat(ONE, 3, 0), (1, 1)),
        # The point outside counts on neither side.
        (np.concatenate([ONE, ONE + 100]), ONE, (1, 1)),
    ],
)
def test_degenerate_inputs(p1, p2, expected):
    d1, d2 = np.ones((len(p1), 4), np.float32), np.ones((len(p2), 4), np.float32)
    assert rep_and_ms(p1, p2, d1, d2, np.eye(3), SIZE1, SIZE1) == expected


def test_a_match_in_place_with_the_wrong_descriptor_is_repeated_but_not_matched():
    points = np.array([[10.0, 10.0], [40.0, 30.0]], np.float32)
    d = np.eye(2, dtype=np.float32)
    assert rep_and_ms(points, points, d, d[::-1].copy(), np.eye(3), SIZE1, SIZE1) == (1.0, 0.0)
