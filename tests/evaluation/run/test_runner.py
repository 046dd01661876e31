"""Runs: every pair, equal counts, several processes, and what can't be evaluated."""

from __future__ import annotations

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes import SMALL, same

from elf_eval.errors import EvalError
from elf_eval.protocol import Protocol
from elf_eval.run.runner import Resources, run
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite
from helpers import textured


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


@pytest.fixture
def moved_folder(tmp_path):
    """A picture and what a homography that is nearly a shift makes of it, each with noise, in HPatches' layout."""
    folder = tmp_path / "moved" / "v_moved"
    folder.mkdir(parents=True)
    matrix = np.array([[1.002, 0.004, 3.3], [-0.003, 0.998, 2.7], [2e-6, -3e-6, 1.0]])
    image = cv2.GaussianBlur(textured(240, 320, seed=5), (0, 0), 1.0)
    rng = np.random.default_rng(1)
    for number, clean in enumerate([image, cv2.warpPerspective(image, matrix, (320, 240), flags=cv2.INTER_CUBIC)], 1):
        noisy = np.clip(clean + rng.normal(0, 6, clean.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"{number}.png"), noisy)
    np.savetxt(folder / "H_1_2", matrix)
    return folder.parent


@pytest.mark.parametrize("size", [None, (256, 192)])
def test_refined_matches_of_any_detector_lower_the_error(moved_folder, resources, size):
    """The images are refined at the size that they are evaluated at."""
    methods = [
        MethodEntry(f"{text} {how}", f"{text}?ratio=0.9&refine={how}")
        for text in ("sift", "elf")
        for how in ("false", "true")
    ]
    dataset = [DatasetEntry("moved", f"hpatches:{moved_folder}")]
    results = run(Suite(methods, dataset, protocol=Protocol(size=size, max_keypoints=200)), resources)
    found = {p.method: p.metrics for p in results.pairs}
    for text in ("sift", "elf"):
        plain, refined = found[f"{text} false"], found[f"{text} true"]
        assert refined["h_error"] < plain["h_error"]
        assert refined["mma@1"] > plain["mma@1"]
        assert [refined[name] for name in ("rep", "ms", "matches")] == [plain[n] for n in ("rep", "ms", "matches")]
    assert len(list(resources.cache.glob("*/*.npz"))) == 2 * 2  # refined or not, the features are the same


def test_a_method_s_own_refinement_goes_before_the_protocol_s(suite, resources):
    methods = [
        MethodEntry("plain", "sift"),
        MethodEntry("own", "sift?refine=false"),
        MethodEntry("both", "gftt?refine=true", "sift?refine=false"),
        MethodEntry("detector's", "gftt?refine=false", "sift"),
    ]
    several = replace(suite, methods=methods)
    for shared in (False, True):
        results = run(replace(several, protocol=replace(suite.protocol, refine=shared)), resources)
        assert results.protocol["refine"] is shared
        assert {m["name"]: m["refine"] for m in results.methods} == {
            "plain": shared, "own": False, "both": False, "detector's": False
        }  # fmt: skip
    plain, own = (results.of("two", name, "own") for name in ("plain", "own"))
    assert [p.metrics["mma@1"] for p in plain] != [p.metrics["mma@1"] for p in own]


def test_refined_pairs_go_on_where_they_were_interrupted(suite, resources, tmp_path):
    """Of the same run with refinement, nothing that was measured without it is taken."""
    log = tmp_path / "unfinished.jsonl"
    refined = replace(suite, protocol=replace(suite.protocol, refine=True))
    run(suite, resources, log)
    lines = len(log.read_text().splitlines())
    assert same(run(refined, resources, log), run(refined, resources))
    assert len(log.read_text().splitlines()) == 2 * lines
    run(refined, resources, log)
    assert len(log.read_text().splitlines()) == 2 * lines
