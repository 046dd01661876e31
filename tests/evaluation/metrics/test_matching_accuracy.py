"""Mean matching accuracy."""

from __future__ import annotations

import numpy as np

from elf_eval.metrics.matching_accuracy import mean_matching_accuracy


def test_mean_matching_accuracy_counts_ends_and_leaves_the_unknown_out():
    assert mean_matching_accuracy(np.array([0.5, 1.0, 2.5, np.nan, 10.0])) == [0.5, 0.5, *[0.75] * 7, 1.0]
    assert mean_matching_accuracy(np.zeros(0)) == [0.0] * 10
    assert mean_matching_accuracy(np.array([np.nan])) == [0.0] * 10
