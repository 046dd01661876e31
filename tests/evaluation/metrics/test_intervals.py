"""Intervals of means and of differences: they hold the truth as often as they say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from elf_eval.metrics.intervals import Difference, mean_interval, paired_difference
from elf_eval.metrics.student import quantile, two_sided


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
