"""Statistics of timings, against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from elf_runtime.timing.statistics import median_interval, paired_ratio, summary


def test_percentiles_are_linear_between_neighbours() -> None:
    found = summary([float(v) for v in range(101)])
    assert (found.count, found.p50, found.p95, found.p99) == (101, 50.0, 95.0, 99.0)
    assert summary([1.0, 2.0]).p50 == 1.5
    assert summary([1.0, 2.0]).p95 == pytest.approx(1.95)


def test_percentiles_do_not_depend_on_the_order() -> None:
    values = [3.0, 1.0, 2.0, 10.0]
    assert summary(values) == summary(sorted(values))


def test_one_sample_is_all_its_percentiles() -> None:
    found = summary([4.0])
    assert found.p50 == found.p95 == found.p99 == 4.0


def test_the_interval_holds_the_median_and_repeats() -> None:
    values = list(np.random.default_rng(1).normal(10.0, 1.0, 50))
    found = median_interval(values)
    assert found.low <= found.value <= found.high
    assert found.value == np.median(values)
    assert found == median_interval(values)
    # The median of 50 normal samples has a standard error of about 1.25 / sqrt(50) = 0.18.
    assert 0.3 < found.high - found.low < 1.4


def test_more_confidence_is_a_wider_interval() -> None:
    values = list(np.random.default_rng(2).normal(10.0, 1.0, 40))
    narrow, wide = median_interval(values, 0.5), median_interval(values, 0.99)
    assert wide.low < narrow.low
    assert narrow.high < wide.high


def test_the_interval_covers_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    intervals = [median_interval(list(rng.normal(0.0, 1.0, 30)), 0.9) for _ in range(200)]
    covered = sum(i.low <= 0.0 <= i.high for i in intervals) / len(intervals)
    assert 0.82 <= covered <= 0.98


def test_a_paired_ratio_is_free_of_common_drift() -> None:
    drift = np.linspace(1.0, 5.0, 21)
    found = paired_ratio(list(0.6 * drift), list(drift))
    assert found.value == pytest.approx(0.6)
    assert found.low == pytest.approx(0.6)
    assert found.high == pytest.approx(0.6)


def test_a_paired_ratio_is_the_median_of_ratios() -> None:
    assert paired_ratio([1.0, 2.0, 9.0], [1.0, 4.0, 3.0]).value == 1.0


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda: summary([]), "no samples"),
        (lambda: median_interval([]), "no samples"),
        (lambda: median_interval([1.0], 1.0), "confidence"),
        (lambda: paired_ratio([1.0], [1.0, 2.0]), "don't pair"),
        (lambda: paired_ratio([1.0], [0.0]), "above 0"),
        (lambda: paired_ratio([1.0], [float("nan")]), "above 0"),
    ],
)
def test_what_has_no_answer_raises(call, reason) -> None:
    with pytest.raises(ValueError, match=reason):
        call()
