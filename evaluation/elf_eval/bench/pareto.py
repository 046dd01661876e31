"""What a matching score costs: the time of every method in one interleaved run, beside its figures of a run."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError, reason
from elf_eval.geometry import Size
from elf_eval.report.summary import Keypoints, having, keypoints, scene_means, summarize
from elf_eval.run.results import Results
from elf_eval.suite.suite import MethodEntry, Suite
from elf_runtime.timing.environment import environment
from elf_runtime.timing.interleave import Workload, interleaved
from elf_runtime.timing.statistics import Interval, median_interval, paired_ratio

from .separate import Alone

SCHEMA = 1
METRICS = ("rep", "ms", "mma@3", "h_auc@1", "h_auc@3", "h_auc@5")
_VERSIONS = ("cpu", "usable_cores", "threads", "python", "onnxruntime", "numpy", "opencv")


@dataclass(frozen=True)
class Point:
    """One method.

    Attributes
    ----------
    family : str
        Methods of one family share a marker.
    milliseconds : Interval
        Median time of detection and description of one image, with its 95 % interval.
    ratio : Interval
        Of that to the reference's time in the same round.
    keypoints : Keypoints
        Over the images of the dataset.
    quality : dict
        Metric -> mean over scenes, in [0, 1]; None where the method has no descriptors.
    groups : dict
        Group of scenes -> matching score there.
    """

    name: str
    family: str
    milliseconds: Interval
    ratio: Interval
    keypoints: Keypoints
    quality: Mapping[str, float | None]
    groups: Mapping[str, float | None]

    @property
    def score(self) -> float | None:
        """The matching score."""
        return self.quality["ms"]


@dataclass(frozen=True)
class Study:
    """All points, and what they were measured on; `about` is plain data."""

    points: list[Point]
    about: dict[str, Any]

    def save(self, path: Path) -> None:
        points = [{**asdict(p), "on_front": p in front(self.points)} for p in self.points]
        data = {"schema": SCHEMA, "about": self.about, "points": points}
        path.write_text(json.dumps(_rounded(data), indent=1) + "\n")

    @classmethod
    def load(cls, path: Path) -> Study:
        """Read what `save` wrote.

        Raises
        ------
        EvalError
            If the file is missing, no such data, or of another schema.
        """
        try:
            data = json.loads(path.read_text())
            if data["schema"] != SCHEMA:
                raise EvalError(f"{path}: schema {data['schema']}, this version reads {SCHEMA}; measure again")
            return cls([_point(entry) for entry in data["points"]], data["about"])
        except OSError as error:
            raise EvalError(f"{path}: {reason(error)}") from error
        except (ValueError, KeyError, TypeError) as error:
            raise EvalError(f"{path}: not the data of elf-eval pareto: {error}") from error


def front(points: Sequence[Point]) -> list[Point]:
    """The points that no other beats in both time and matching score, the fastest first."""
    kept: list[Point] = []
    order = [(p.milliseconds.value, -p.score, p) for p in points if p.score is not None]
    for _, score, point in sorted(order, key=lambda item: item[:2]):
        if not kept or -score > (kept[-1].score or 0.0):
            kept.append(point)
    return kept


def study(
    suite: Suite,
    results: Results,
    image: Path,
    reference: str,
    repeats: int,
    warmup: int,
    threads: int,
) -> Study:
    """Time the methods of `suite` that `results` has, on one image at the size of the results' protocol.

    Parameters
    ----------
    image : Path
        A photograph; resized as the datasets' images are, before the clock starts.
    reference : str
        The method that the ratios are to.

    Raises
    ------
    EvalError
        If no method, or not the reference, is in both, or the results are of several datasets.
    """
    if len(results.datasets) != 1:
        raise EvalError(f"the results are of {len(results.datasets)} datasets; one picture shows one")
    measured = {m["name"] for m in results.methods}
    entries = [entry for entry in suite.methods if entry.name in measured]
    if reference not in {entry.name for entry in entries}:
        raise EvalError(f"no method {reference!r} in the suite and the results; there are {sorted(measured)}")
    limit = results.protocol["max_keypoints"]
    size = results.protocol["size"]
    photo = ImageRef(image.name, image)
    size = tuple(size) if size else None
    width, height = photo.open(size).size
    samples = _times([partial(_start, suite, entry, photo, size, limit, threads) for entry in entries], repeats, warmup)
    compared = samples[[entry.name for entry in entries].index(reference)]
    dataset = results.datasets[0]["name"]
    points = []
    measured_pairs: set[tuple[str, str]] = set()
    for entry, seconds in zip(entries, samples, strict=True):
        pairs = results.of(dataset, entry.name, "own")
        if not pairs:
            raise EvalError("the results are without each method's own counts")
        pairs = having(pairs, "rep") or pairs
        measured_pairs |= {(p.scene, p.pair) for p in pairs}
        estimates = {metric: summarize(pairs, metric) for metric in METRICS}
        scores = scene_means(pairs, "ms")
        points.append(
            Point(
                entry.name,
                entry.family,
                median_interval([1e3 * s for s in seconds]),
                paired_ratio(seconds, compared),
                keypoints(pairs),
                {metric: None if e is None else e.mean for metric, e in estimates.items()},
                {group: _mean(scores, scenes) for group, scenes in suite.groups.items()},
            )
        )
    about = {
        "note": suite.note,
        "dataset": dataset,
        "pairs": len(measured_pairs),
        "max_keypoints": limit,
        "image": image.name,
        "width": width,
        "height": height,
        "reference": reference,
        "repeats": repeats,
        "warmup": warmup,
        "groups": suite.groups,
        "environment": {k: v for k, v in environment(threads, "cpu").items() if k in _VERSIONS},
    }
    return Study(points, about)


def _start(suite: Suite, entry: MethodEntry, photo: ImageRef, size: Size | None, limit: int, threads: int) -> Alone:
    try:
        return Alone(*suite.texts(entry), photo, size, limit, threads)
    except EvalError as error:
        raise EvalError(f"method {entry.name!r}: {error}{suite.origin(entry)}") from error


def _times(starts: Sequence[Callable[[], Alone]], repeats: int, warmup: int) -> list[list[float]]:
    """Seconds of each method's repetitions, in its order; each method has a process of its own."""

    def contender(name: str, method: Alone) -> Workload:
        return Workload(name, name, lambda: (method.run(), {}))

    with ExitStack() as stack:
        methods = [stack.enter_context(start()) for start in starts]
        contenders = [contender(str(i), method) for i, method in enumerate(methods)]
        samples, _ = interleaved(contenders, warmup, repeats)
    return [samples[c.name] for c in contenders]


def _mean(values: Mapping[str, float], names: Sequence[str]) -> float | None:
    there = [values[name] for name in names if name in values]
    return sum(there) / len(there) if there else None


def _point(entry: Mapping[str, Any]) -> Point:
    made = {"milliseconds": Interval, "ratio": Interval, "keypoints": Keypoints}
    plain = {key: entry[key] for key in ("name", "family", "quality", "groups")}
    return Point(**plain, **{key: make(**entry[key]) for key, make in made.items()})


def _rounded(data: Any) -> Any:
    """Five significant digits: what is beyond them is noise."""
    if isinstance(data, dict):
        return {key: _rounded(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_rounded(value) for value in data]
    return float(f"{data:.5g}") if isinstance(data, float) else data
