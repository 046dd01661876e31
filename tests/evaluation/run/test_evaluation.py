"""The key that a pair's metrics are kept under."""

from __future__ import annotations

import inspect
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
from scenes import SMALL, photograph

import elf_runtime
from elf_eval.data import Dataset, Pair
from elf_eval.data.images import ImageRef
from elf_eval.data.truth import Homography
from elf_eval.fingerprint import _files
from elf_eval.run.evaluation import pair_evaluations
from elf_eval.run.extraction import CachedFeatures

REFINED = replace(SMALL, refine=True)


@pytest.fixture
def pair(tmp_path):
    refs = [ImageRef(f"{n}.png", tmp_path / f"{n}.png") for n in (1, 2)]
    for number, ref in enumerate(refs):
        cv2.imwrite(str(ref.path), photograph(number))
    return Pair("a", *refs, Homography())


def keys(pair, *protocols):
    """Of methods with the same features, one for each protocol."""
    methods = {str(number): protocol for number, protocol in enumerate(protocols)}
    refs = (pair.first, pair.second)
    features = {(m, ref): CachedFeatures(ref.path, ref.name, 5, 0.1) for m in methods for ref in refs}
    return [evaluation.key for evaluation in pair_evaluations(methods, Dataset("set", (pair,)), features)]


def test_refined_pairs_are_kept_apart(pair):
    assert len(set(keys(pair, SMALL, REFINED, replace(SMALL, ratio=0.8), replace(REFINED, ratio=0.8)))) == 4


@pytest.mark.parametrize("which", ["first", "second"])
def test_refined_pairs_depend_on_the_images(pair, which):
    """Features that another program wrote stay the same when an image is replaced."""
    before = keys(pair, SMALL, REFINED)
    cv2.imwrite(str(getattr(pair, which).path), photograph(7))
    after = keys(pair, SMALL, REFINED)
    assert after[0] == before[0]
    assert after[1] != before[1]


def test_refined_pairs_depend_on_the_code_that_refines(pair, monkeypatch):
    changed = Path(inspect.getfile(elf_runtime.refine))

    def digest(*modules):
        return "new" if changed in {path for module in modules for path in _files(module)} else "old"

    monkeypatch.setattr("elf_eval.run.evaluation.code_digest", digest)
    before = keys(pair, SMALL, REFINED)
    changed = None
    after = keys(pair, SMALL, REFINED)
    assert after[0] == before[0]
    assert after[1] != before[1]
