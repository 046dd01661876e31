"""The metrics against plain loops, on random and degenerate inputs."""

from __future__ import annotations

import math

import loops
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elf_eval.coordinates import inside, resize_matrix, warp
from elf_eval.metrics.auc import auc
from elf_eval.metrics.intervals import Difference, mean_interval, paired_difference
from elf_eval.metrics.matching import descriptor_distances, mutual_nearest
from elf_eval.metrics.matching_accuracy import mean_matching_accuracy
from elf_eval.metrics.student import quantile, two_sided
from elf_runtime.checks.greedy import greedy_matching
from elf_runtime.checks.repeatability import covisible, repeatability_and_matching_score

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


def test_greedy_is_not_mutual_nearest_neighbours():
    # 0-0 goes first; 1-1 is nobody's first choice and must still be taken.
    distance = np.array([[1.0, 2.0], [2.0, 9.0]])
    assert greedy_matching(distance).tolist() == [[0, 0], [1, 1]]
    assert mutual_nearest(distance).tolist() == [[0, 0]]


def test_greedy_on_a_chain_takes_as_many_rounds_as_there_are_links():
    # Every point's nearest neighbour prefers the next one: only one pair is mutual in each round.
    x = np.cumsum(np.arange(40, 0, -1.0))
    distance = np.abs(x[0::2, None] - x[None, 1::2])
    assert [tuple(p) for p in greedy_matching(distance).tolist()] == loops.greedy(distance.tolist())


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


def test_points_behind_the_horizon_are_dropped():
    matrix = np.array([[1.0, 0, 0], [0, 1, 0], [-0.1, 0, 1]])  # the line x = 10 goes to infinity
    warped = warp(matrix, [[5.0, 5.0], [10.0, 5.0], [15.0, 5.0]])
    assert np.isfinite(warped[0]).all()
    assert np.isnan(warped[1:]).all()
    assert not inside(warped, SIZE1)[1:].any()


def test_inside_spans_whole_pixels():
    points = np.array([[-0.5, 0], [-0.51, 0], [59.49, 39.49], [59.5, 0], [0, 39.5]])
    assert inside(points, SIZE1).tolist() == [True, False, True, False, False]


def test_resizing_keeps_the_images_edges_together():
    matrix = resize_matrix((1000, 700), (640, 480))
    assert warp(matrix, [[-0.5, -0.5], [999.5, 699.5]]) == pytest.approx(np.array([[-0.5, -0.5], [639.5, 479.5]]))


def test_descriptor_distances(rng):
    a, b = rng.normal(size=(7, 16)).astype(np.float32), rng.normal(size=(5, 16)).astype(np.float32)
    expected = np.linalg.norm(a[:, None].astype(float) - b[None].astype(float), axis=2)
    assert descriptor_distances(a, b) == pytest.approx(expected, abs=1e-12)
    x, y = (rng.integers(0, 256, (n, 32), np.uint8) for n in (6, 9))
    bits = [[sum((int(p) ^ int(q)).bit_count() for p, q in zip(u, v, strict=True)) for v in y] for u in x]
    assert descriptor_distances(x, y).tolist() == bits


def test_mean_matching_accuracy_counts_ends_and_leaves_the_unknown_out():
    assert mean_matching_accuracy(np.array([0.5, 1.0, 2.5, np.nan, 10.0])) == [0.5, 0.5, *[0.75] * 7, 1.0]
    assert mean_matching_accuracy(np.zeros(0)) == [0.0] * 10
    assert mean_matching_accuracy(np.array([np.nan])) == [0.0] * 10


def test_auc_is_the_area_under_the_recall_curve(rng):
    errors = rng.uniform(0, 8, 200)
    steps = np.linspace(0, 5, 100001)
    recall = (errors[:, None] <= steps[None, ::100]).mean(axis=0)
    assert np.mean([auc(e, 5) for e in errors]) == pytest.approx(recall.mean(), abs=2e-3)
    assert auc(math.inf, 5) == 0.0
    assert auc(0.0, 5) == 1.0


@pytest.mark.parametrize(("freedom", "wanted"), [(1, 12.706), (2, 4.3027), (3, 3.1824), (7, 2.3646), (30, 2.0423)])
def test_student_s_quantiles_are_those_of_the_tables(freedom, wanted):
    assert quantile(0.95, freedom) == pytest.approx(wanted, abs=5e-4)
    assert two_sided(wanted, freedom) == pytest.approx(0.05, abs=1e-4)
    assert two_sided(-wanted, freedom) == two_sided(wanted, freedom)
    assert (two_sided(0.0, freedom), two_sided(math.inf, freedom)) == (1.0, 0.0)


def test_student_s_tail_between_the_tables():
    """P(|T| > 2) = 1 - 2 / pi atan 2 for one and 1 - 2 / sqrt 6 for two degrees of freedom, by hand."""
    assert two_sided(2.0, 1) == pytest.approx(1 - 2 / math.pi * math.atan(2.0))
    assert two_sided(2.0, 2) == pytest.approx(1 - 2 / math.sqrt(6))
    assert two_sided(2.0, 5) == pytest.approx(0.101939, abs=1e-6)


@pytest.mark.parametrize("scenes", [2, 3, 5, 8])
def test_the_interval_covers_the_mean_as_often_as_it_says(scenes, rng):
    estimates = [mean_interval(values) for values in rng.normal(3.0, 1.0, (4000, scenes))]
    covered = np.mean([e.low <= 3.0 <= e.high for e in estimates])
    assert covered == pytest.approx(0.95, abs=0.012)  # 3.5 standard errors of 4000 draws
    assert math.isnan(mean_interval([1.0]).low)


def draws(kind, rng, size):
    return {"normal": rng.normal, "laplace": rng.laplace, "uniform": rng.uniform}[kind](
        *((-1.0, 1.0) if kind == "uniform" else (0.0, 1.0)), size
    )


@pytest.mark.parametrize(("kind", "most"), [("normal", 0.06), ("laplace", 0.06), ("uniform", 0.09)])
@pytest.mark.parametrize("scenes", [2, 3, 4, 8])
def test_two_methods_that_do_not_differ_are_told_apart_in_5_percent(kind, most, scenes, rng):
    """The difference of every scene is drawn with mean 0; a bootstrap over 3 scenes saw a difference in 22 %."""
    names = [str(i) for i in range(scenes)]
    base = dict.fromkeys(names, 0.5)
    deltas = draws(kind, rng, (4000, scenes))
    verdicts = [paired_difference(base, dict(zip(names, 0.5 + d, strict=True))).is_noise for d in deltas]
    rate = 1.0 - np.mean(verdicts)
    assert 0.025 < rate < most


def test_p_and_interval_agree(rng):
    for _ in range(500):
        a = {str(i): float(v) for i, v in enumerate(rng.normal(0.6, 1.0, 5))}
        found = paired_difference(dict.fromkeys(a, 0.0), a)
        assert found.is_noise == (found.p >= 0.05)


def test_a_paired_difference_sees_what_the_spread_of_scenes_hides(rng):
    a = {str(i): float(v) for i, v in enumerate(rng.normal(0.5, 0.2, 12))}
    b = {k: v + 0.02 + float(rng.normal(0, 0.005)) for k, v in a.items()}
    found = paired_difference(a, b)
    assert not found.is_noise
    assert found.p < 0.01
    assert found.mean == pytest.approx(0.02, abs=0.005)
    noise = paired_difference(a, {k: v + float(rng.normal(0, 0.05)) for k, v in a.items()})
    assert noise.is_noise
    assert paired_difference(a, {"0": 1.0}).is_noise  # a single scene tells nothing


@pytest.mark.parametrize(("count", "noise"), [(2, True), (5, True), (6, False), (20, False)])
def test_differences_without_spread_are_judged_by_their_sign_alone(count, noise):
    scenes = [str(n) for n in range(count)]
    found = paired_difference(dict.fromkeys(scenes, 1.0), dict.fromkeys(scenes, 2.0))
    assert found.p == pytest.approx(2.0 / 2**count)
    assert found.is_noise == noise == math.isnan(found.low)
    same = paired_difference(dict.fromkeys(scenes, 1.0), dict.fromkeys(scenes, 1.0))
    assert (same.mean, same.low, same.high, same.p) == (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("low", "high", "noise"),
    [
        (0.0, 2.0, True),
        (-1.0, 0.0, True),
        (-1.0, 1.0, True),
        (math.nan, math.nan, True),
        (0.1, 2.0, False),
        (-2.0, -0.1, False),
    ],
)
def test_an_interval_that_holds_zero_is_noise(low, high, noise):
    assert Difference(0.5, low, high, 0.5).is_noise == noise
