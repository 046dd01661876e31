"""Comparisons."""

from __future__ import annotations

from dataclasses import replace

from made_results import PLACED, pair, results

from elf_eval.report.comparison import compare, verdict, warnings


def test_a_comparison_counts_what_has_the_metric(some_with_depth):
    found = {c.metric: c for c in compare(results(some_with_depth), results(some_with_depth))}
    assert (found["rep"].pairs, found["rep"].units) == (2, 1)
    assert (found["pose_auc@10"].pairs, found["pose_auc@10"].units) == (8, 3)
    assert [verdict(found[metric]) for metric in ("rep", "pose_auc@10")] == ["too few to tell", "noise"]


def test_another_ratio_is_a_difference_to_know_about():
    plain = results([pair("a", 1, PLACED)])
    assert warnings(plain, results([pair("a", 1, PLACED)], ratio=0.8)) == ["protocol ratio: None -> 0.8"]
    own = replace(plain, methods=[{**plain.methods[0], "ratio": 0.8}])
    older = replace(plain, protocol={k: v for k, v in plain.protocol.items() if k != "ratio"})
    assert warnings(older, own) == ["method SIFT: ratio None -> 0.8"]
    assert warnings(older, plain) == warnings(plain, older) == []


def test_refined_matches_are_a_difference_to_know_about():
    plain = results([pair("a", 1, PLACED)])
    assert warnings(plain, results([pair("a", 1, PLACED)], refine=True)) == ["protocol refine: False -> True"]
    own = replace(plain, methods=[{**plain.methods[0], "refine": True}])
    older = replace(plain, protocol={k: v for k, v in plain.protocol.items() if k not in ("refine", "count_floor")})
    assert warnings(older, own) == ["method SIFT: refine False -> True"]
    assert warnings(older, plain) == warnings(plain, older) == []
