"""Time against quality: a point for each method, the front, and the file that keeps them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from elf_eval.errors import EvalError, reason
from elf_eval.run.averages import Keypoints, Median
from elf_runtime.timing.statistics import Interval

SCHEMA = 1


@dataclass(frozen=True)
class Point:
    """What a method takes and what it gives.

    Attributes
    ----------
    family : str
        Methods of one family have the same marker.
    milliseconds : Interval
        Median time to detect and describe the keypoints of one image, with its 95 % interval.
    ratio : Interval
        Of this time to the reference's in the same round.
    keypoints : Keypoints
        Over the images of the dataset.
    quality : dict
        Share -> mean over scenes, in [0, 1]; None where it needs descriptors and the method has none.
    epipolar : Median, optional
        Of the epipolar distances, in pixels; None where the cameras are not known.
    groups : dict
        Group of scenes -> matching score on them.
    """

    name: str
    family: str
    milliseconds: Interval
    ratio: Interval
    keypoints: Keypoints
    quality: Mapping[str, float | None]
    epipolar: Median | None
    groups: Mapping[str, float | None]


@dataclass(frozen=True)
class Study:
    """All points, and what they were measured on; `about` is plain data."""

    points: list[Point]
    about: dict[str, Any]

    def save(self, path: Path) -> None:
        fronts = {metric: front(self.points, metric) for metric in self.metrics()}
        on = {p.name: [metric for metric in fronts if p in fronts[metric]] for p in self.points}
        points = [{**asdict(p), "on_front": on[p.name]} for p in self.points]
        data = {"schema": SCHEMA, "about": self.about, "points": points}
        path.write_text(json.dumps(_rounded(data), indent=1) + "\n", encoding="utf-8")

    def metrics(self) -> list[str]:
        """The shares that some point has."""
        return list(dict.fromkeys(name for p in self.points for name, value in p.quality.items() if value is not None))

    @classmethod
    def load(cls, path: Path) -> Study:
        """Read what `save` wrote.

        Raises
        ------
        EvalError
            If the file is missing, does not hold such data, or has another schema.
        """
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data["schema"] != SCHEMA:
                raise EvalError(f"{path}: schema {data['schema']}, this version reads {SCHEMA}; measure again")
            return cls([_point(entry) for entry in data["points"]], data["about"])
        except OSError as error:
            raise EvalError(f"{path}: {reason(error)}") from error
        except (ValueError, KeyError, TypeError) as error:
            raise EvalError(f"{path}: not the data of elf-eval pareto: {error}") from error


def front(points: Sequence[Point], metric: str) -> list[Point]:
    """The points that no other one beats in both time and a share, the fastest first."""
    kept: list[Point] = []
    best = -1.0
    order = [(p.milliseconds.value, -score, p) for p in points if (score := p.quality.get(metric)) is not None]
    for _, loss, point in sorted(order, key=lambda item: item[:2]):
        if -loss > best:
            kept.append(point)
            best = -loss
    return kept


def _point(entry: Mapping[str, Any]) -> Point:
    made = {"milliseconds": Interval, "ratio": Interval, "keypoints": Keypoints}
    plain = {key: entry[key] for key in ("name", "family", "quality", "groups")}
    epipolar = Median(**entry["epipolar"]) if entry.get("epipolar") else None
    return Point(**plain, epipolar=epipolar, **{key: make(**entry[key]) for key, make in made.items()})


def _rounded(data: Any) -> Any:
    """To five significant digits: what is beyond them is noise."""
    if isinstance(data, dict):
        return {key: _rounded(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_rounded(value) for value in data]
    return float(f"{data:.5g}") if isinstance(data, float) else data
