"""Comparisons."""

from __future__ import annotations

from made_results import results

from elf_eval.report.comparison import compare, verdict


def test_a_comparison_counts_what_has_the_metric(some_with_depth):
    found = {c.metric: c for c in compare(results(some_with_depth), results(some_with_depth))}
    assert (found["rep"].pairs, found["rep"].units) == (2, 1)
    assert (found["pose_auc@10"].pairs, found["pose_auc@10"].units) == (8, 3)
    assert [verdict(found[metric]) for metric in ("rep", "pose_auc@10")] == ["too few to tell", "noise"]
