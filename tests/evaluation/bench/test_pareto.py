"""The front, and a study's file."""

from __future__ import annotations

import numpy as np
import pytest

from elf_eval.bench.measurement import METRICS
from elf_eval.bench.pareto import Point, Study, front
from elf_eval.errors import EvalError
from elf_eval.run.averages import Keypoints
from elf_runtime.timing.statistics import Interval


def point(name: str, time: float, score: float | None) -> Point:
    quality = {metric: score if metric == "ms" else 0.5 for metric in METRICS}
    return Point(name, "f", Interval(time, time, time), Interval(1, 1, 1), Keypoints(5.0, 4), quality, {})


def tied(b, found):
    return any(a.milliseconds == b.milliseconds and a.score == b.score for a in found)


def test_the_front_is_what_none_beats_in_both():
    rng = np.random.default_rng(0)
    points = [point(str(i), *rng.integers(1, 30, 2).astype(float)) for i in range(60)]
    found = front([*points, point("no score", 0.1, None)])
    times, scores = [p.milliseconds.value for p in found], [p.score for p in found]
    assert times == sorted(set(times))
    assert scores == sorted(set(scores))

    def beats(a, b):
        better = a.milliseconds.value < b.milliseconds.value or a.score > b.score
        return better and a.milliseconds.value <= b.milliseconds.value and a.score >= b.score

    assert not any(beats(a, b) for a in points for b in found)
    assert all(any(beats(a, b) for a in found) or vars(b) in map(vars, found) or tied(b, found) for b in points)


def test_other_data_is_refused(tmp_path):
    (tmp_path / "p.json").write_text('{"schema": 0}')
    with pytest.raises(EvalError, match=r"p\.json: schema 0"):
        Study.load(tmp_path / "p.json")
    (tmp_path / "p.json").write_text("[")
    with pytest.raises(EvalError, match=r"p\.json: not the data"):
        Study.load(tmp_path / "p.json")
