"""Averages over scenes."""

from __future__ import annotations

import math

import made_results
import numpy as np
import pytest

from elf_eval.run.averages import keypoints, median_error, scene_means
from elf_eval.run.runner import run


@pytest.mark.parametrize(
    ("errors", "value", "failed"),
    [([0.3, 0.1, None], 0.3, 1), ([0.1, None], math.inf, 1), ([0.1, 0.2, 0.4], 0.2, 0), ([None, None], math.inf, 2)],
)
def test_the_median_of_an_error_counts_failures_as_infinite(errors, value, failed):
    pairs = [made_results.pair("a", n, {"epi_median": error}) for n, error in enumerate(errors)]
    found = median_error([*pairs, made_results.pair("b", 1, {})], "epi_median")
    assert (found.value, found.pairs, found.failed) == (value, len(errors), failed)


def test_pairs_without_an_error_have_no_median():
    assert median_error([made_results.pair("a", 1, {})], "epi_median") is None


def test_averages_are_per_scene_then_over_scenes(suite, resources):
    pairs = run(suite, resources).of("two", "SIFT", "own")
    means = scene_means(pairs, "rep")
    assert set(means) == {"i_light", "v_turn"}
    assert means["v_turn"] == pytest.approx(np.mean([p.metrics["rep"] for p in pairs if p.scene == "v_turn"]))
    assert keypoints(pairs).mean == pytest.approx(60, abs=15)
