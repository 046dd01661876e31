"""Runs: every pair, equal counts, several processes, and what can't be evaluated."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
from scenes import SMALL, same

from elf_eval.errors import EvalError
from elf_eval.run.runner import Resources, run
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite


def test_a_run_has_every_pair_and_the_same_figures_again(suite, resources):
    first = run(suite, resources)
    assert len(first.pairs) == 4 * 3 * 2
    assert same(first, run(suite, resources))
    darker = [p for p in first.of("two", "SIFT", "own") if p.second.endswith("2.png")]
    assert all(p.metrics["rep"] > 0.5 and p.metrics["ms"] > 0.3 for p in darker)
    assert "ms" not in first.of("two", "few", "own")[0].metrics


def test_two_processes_give_what_one_gives(suite, resources):
    alone = run(suite, resources)
    assert same(alone, run(suite, Resources(resources.cache, workers=2, threads=1, quiet=True)))


def test_equal_counts_are_the_fewest_of_each_image(suite, resources):
    results = run(suite, resources)
    fewest = {p.first: p.metrics["n1"] for p in results.of("two", "few", "own")}
    for method in ("SIFT", "ORB", "few"):
        for pair in results.of("two", method, "equal"):
            assert pair.metrics["n1"] == fewest[pair.first] < 60


def test_an_optional_method_is_left_out_with_its_reason(suite, resources):
    some = MethodEntry("ELF", "elf:${WHERE}/none.onnx", optional=True)
    there = Suite([*suite.methods, some], suite.datasets, protocol=SMALL, variables={"WHERE": "/a/folder"})
    results = run(there, resources)
    assert results.skipped[0]["name"] == "ELF"
    assert "${WHERE}/none.onnx" in results.skipped[0]["reason"]
    assert "/a/folder" not in results.skipped[0]["reason"]
    with pytest.raises(EvalError, match=r"'ELF'.*none\.onnx"):
        run(Suite([MethodEntry("ELF", "elf:none.onnx")], suite.datasets), resources)


def test_a_homography_that_does_not_fit_is_named(hpatches_folder, tmp_path, resources, suite):
    shutil.copytree(hpatches_folder, tmp_path / "set")
    np.savetxt(tmp_path / "set" / "v_turn" / "H_1_3", [[1, 0, 5000], [0, 1, 0], [0, 0, 1]])
    wrong = Suite(suite.methods, [DatasetEntry("two", f"hpatches:{tmp_path / 'set'}")], protocol=SMALL)
    with pytest.raises(EvalError, match=r"v_turn/1\.png - v_turn/3\.png: the homography does not fit"):
        run(wrong, resources)


def test_equal_counts_have_a_floor(suite, resources):
    floor = replace(suite, protocol=replace(suite.protocol, count_floor=40))
    results, plain = run(floor, resources), run(suite, resources)
    own = {(p.method, p.first): p.metrics["n1"] for p in plain.pairs if p.counts == "own"}
    for pair in results.pairs:
        fewest = min(own[method, pair.first] for method in ("SIFT", "ORB", "few"))
        kept = max(40, fewest) if pair.counts == "equal" else 60
        assert pair.metrics["n1"] == min(own[pair.method, pair.first], kept)
    assert any(fewest < 40 for (method, _), fewest in own.items() if method == "few")


def test_a_method_s_own_ratio_goes_before_the_protocol_s(suite, resources):
    methods = [
        MethodEntry("plain", "sift"),
        MethodEntry("own", "sift?ratio=0.5"),
        MethodEntry("both", "gftt?ratio=0.9", "sift?ratio=0.5"),
        MethodEntry("detector's", "gftt?ratio=0.9", "sift"),
    ]
    results = run(replace(suite, methods=methods, protocol=replace(suite.protocol, ratio=0.7)), resources)
    assert {m["name"]: m["ratio"] for m in results.methods} == {
        "plain": 0.7, "own": 0.5, "both": 0.5, "detector's": 0.9
    }  # fmt: skip
    plain, own = (results.of("two", name, "own") for name in ("plain", "own"))
    assert all(a.metrics["ms"] == b.metrics["ms"] for a, b in zip(plain, own, strict=True))
    assert sum(p.metrics["matches"] for p in own) < sum(p.metrics["matches"] for p in plain)
    assert len(list(resources.cache.glob("*/*.npz"))) == 6 * 3  # of the six images: SIFT, GFTT, and GFTT with SIFT
