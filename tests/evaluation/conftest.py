"""Small data that the tests make themselves."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_eval.run.evaluation import evaluate_pair

sys.path.insert(0, str(Path(__file__).parent))
from scenes import photograph, write_hpatches

_ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def shared() -> Path:
    """The development data beside the project."""
    candidates = [_ROOT.parent / "shared", _ROOT.parent.parent / "shared"]
    if "ELF_SHARED" in os.environ:
        candidates.insert(0, Path(os.environ["ELF_SHARED"]))
    for folder in candidates:
        if (folder / "data" / "oxford_affine").is_dir():
            return folder
    pytest.skip("no shared/data/oxford_affine beside the project (or set ELF_SHARED)")


@pytest.fixture(scope="session")
def hpatches_folder(tmp_path_factory) -> Path:
    """Two scenes of three images in HPatches' layout."""
    root = tmp_path_factory.mktemp("hpatches")
    write_hpatches(root, ["i_light", "v_turn"])
    return root


@pytest.fixture
def photo_file(tmp_path) -> Path:
    path = tmp_path / "photo.png"
    cv2.imwrite(str(path), photograph(3))
    return path


@pytest.fixture
def interrupted_at(monkeypatch):
    """Given n, lets Ctrl-C come with the n-th pair that is evaluated, once; returns the list of those begun."""
    work = evaluate_pair

    def at(count: int) -> list[object]:
        begun: list[object] = []

        def run_pair(job):
            begun.append(job)
            if len(begun) == count:
                raise KeyboardInterrupt
            return work(job)

        monkeypatch.setattr("elf_eval.run.runner.evaluate_pair", run_pair)
        return begun

    return at


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
