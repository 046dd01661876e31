"""The front, and a study's file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from elf_eval.bench.pareto import Point, Study, front
from elf_eval.errors import EvalError
from elf_eval.run.averages import Keypoints, Median
from elf_runtime.timing.statistics import Interval


def point(name: str, time: float, score: float | None) -> Point:
    """A score for h_auc@3; its ms is the same for all."""
    quality = {"ms": 0.5, "h_auc@3": score}
    return Point(name, "f", Interval(time, time, time), Interval(1, 1, 1), Keypoints(5.0, 4), quality, None, {})


def score(of: Point) -> float:
    return of.quality["h_auc@3"]


def tied(b, found):
    return any(a.milliseconds == b.milliseconds and score(a) == score(b) for a in found)


def test_the_front_is_what_none_beats_in_both():
    rng = np.random.default_rng(0)
    points = [point(str(i), *rng.integers(1, 30, 2).astype(float)) for i in range(60)]
    found = front([*points, point("no score", 0.1, None)], "h_auc@3")
    times, scores = [p.milliseconds.value for p in found], [score(p) for p in found]
    assert times == sorted(set(times))
    assert scores == sorted(set(scores))

    def beats(a, b):
        better = a.milliseconds.value < b.milliseconds.value or score(a) > score(b)
        return better and a.milliseconds.value <= b.milliseconds.value and score(a) >= score(b)

    assert not any(beats(a, b) for a in points for b in found)
    assert all(any(beats(a, b) for a in found) or vars(b) in map(vars, found) or tied(b, found) for b in points)


def test_each_metric_has_a_front_of_its_own(tmp_path):
    points = [point("slow", 3.0, 0.9), point("fast", 1.0, 0.2), point("zero", 0.5, 0.0)]
    assert [p.name for p in front(points, "h_auc@3")] == ["zero", "fast", "slow"]
    assert [p.name for p in front(points, "ms")] == ["zero"]
    assert front(points, "epi@1") == []
    points[0] = replace(points[0], epipolar=Median(0.25, 9, 1))
    Study(points, {}).save(tmp_path / "p.json")
    again = Study.load(tmp_path / "p.json")
    assert (again.metrics(), again.points) == (["ms", "h_auc@3"], points)
    saved = {p["name"]: p["on_front"] for p in json.loads((tmp_path / "p.json").read_text())["points"]}
    assert saved == {"zero": ["ms", "h_auc@3"], "fast": ["h_auc@3"], "slow": ["h_auc@3"]}


def test_other_data_is_refused(tmp_path):
    (tmp_path / "p.json").write_text('{"schema": 0}')
    with pytest.raises(EvalError, match=r"p\.json: schema 0"):
        Study.load(tmp_path / "p.json")
    (tmp_path / "p.json").write_text("[")
    with pytest.raises(EvalError, match=r"p\.json: not the data"):
        Study.load(tmp_path / "p.json")
