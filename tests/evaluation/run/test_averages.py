"""Averages over scenes."""

from __future__ import annotations

import numpy as np
import pytest

from elf_eval.run.averages import keypoints, scene_means
from elf_eval.run.runner import run


def test_averages_are_per_scene_then_over_scenes(suite, resources):
    pairs = run(suite, resources).of("two", "SIFT", "own")
    means = scene_means(pairs, "rep")
    assert set(means) == {"i_light", "v_turn"}
    assert means["v_turn"] == pytest.approx(np.mean([p.metrics["rep"] for p in pairs if p.scene == "v_turn"]))
    assert keypoints(pairs).mean == pytest.approx(60, abs=15)
