"""A study is measured: all methods are timed in turns, and their figures come from the results of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from elf_eval.coordinates import Size
from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.metrics.epipolar import EPIPOLAR_ERROR
from elf_eval.metrics.families import is_share
from elf_eval.run.averages import having, keypoints, median_error, metrics_in, scene_means, summarize
from elf_eval.run.results import PairResult, Results
from elf_eval.suite.suite import MethodEntry, Suite
from elf_runtime.timing.environment import environment
from elf_runtime.timing.interleave import Workload, interleaved
from elf_runtime.timing.statistics import median_interval, paired_ratio

from .method_process import MethodProcess
from .pareto import Point, Study

_VERSIONS = ("cpu", "usable_cores", "threads", "python", "onnxruntime", "numpy", "opencv")


@dataclass(frozen=True)
class Timing:
    """How to time: on which image, against which method, how often and with how many threads.

    Attributes
    ----------
    image : Path
        A photograph; before the clock starts, it is resized as the datasets' images are.
    reference : str
        The method that the ratios are to.
    warmup : int
        Rounds that don't count.
    threads : int
        Of each method.
    """

    image: Path
    reference: str
    repeats: int
    warmup: int
    threads: int


def measure(suite: Suite, results: Results, timing: Timing) -> Study:
    """Time the methods of `suite` that `results` has, on one image of the size in the results' protocol.

    Raises
    ------
    EvalError
        If no method, or not the reference, is in both, or the results are of several datasets.
    """
    if len(results.datasets) != 1:
        raise EvalError(f"the results are of {len(results.datasets)} datasets; one picture shows one")
    suite.check_groups({pair.scene for pair in results.pairs})
    measured = {m["name"] for m in results.methods}
    entries = [entry for entry in suite.methods if entry.name in measured]
    names = [entry.name for entry in entries]
    metrics = [metric for metric in metrics_in(results.pairs) if is_share(metric)]
    if timing.reference not in names:
        raise EvalError(f"no method {timing.reference!r} in the suite and the results; there are {sorted(measured)}")
    dataset = results.datasets[0]["name"]
    pairs = {name: _evaluated(results, dataset, name) for name in names}
    size = tuple(results.protocol["size"]) if results.protocol["size"] else None
    limit = results.protocol["max_keypoints"]
    photo = ImageRef(timing.image.name, timing.image)
    width, height = photo.open(size).size
    starts = [partial(_start, suite, entry, photo, size, limit, timing.threads) for entry in entries]
    seconds = dict(zip(names, _times(starts, timing.repeats, timing.warmup), strict=True))
    points = [
        _point(entry, pairs[entry.name], metrics, seconds[entry.name], seconds[timing.reference], suite.groups)
        for entry in entries
    ]
    about = {
        "note": suite.note,
        "dataset": dataset,
        "pairs": len({(p.scene, p.pair) for of_method in pairs.values() for p in of_method}),
        "max_keypoints": limit,
        "image": timing.image.name,
        "width": width,
        "height": height,
        "ratios": {m["name"]: m["ratio"] for m in results.methods if m["name"] in names and m.get("ratio")},
        "refined": [m["name"] for m in results.methods if m["name"] in names and m.get("refine")],
        "reference": timing.reference,
        "repeats": timing.repeats,
        "warmup": timing.warmup,
        "groups": suite.groups,
        "environment": {k: v for k, v in environment(timing.threads, "cpu").items() if k in _VERSIONS},
    }
    return Study(points, about)


def _evaluated(results: Results, dataset: str, method: str) -> list[PairResult]:
    """The method's pairs; those that have the paper's metrics where some do."""
    pairs = results.of(dataset, method, "own")
    if not pairs:
        raise EvalError("the results are without each method's own counts")
    return having(pairs, "rep") or pairs


def _point(
    entry: MethodEntry,
    pairs: Sequence[PairResult],
    metrics: Sequence[str],
    seconds: Sequence[float],
    reference: Sequence[float],
    groups: Mapping[str, Sequence[str]],
) -> Point:
    estimates = {metric: summarize(pairs, metric) for metric in metrics}
    quality = {metric: None if e is None else e.mean for metric, e in estimates.items()}
    scores = scene_means(pairs, "ms")
    return Point(
        entry.name,
        entry.family,
        median_interval([1e3 * s for s in seconds]),
        paired_ratio(seconds, reference),
        keypoints(pairs),
        quality,
        median_error(pairs, EPIPOLAR_ERROR),
        {group: _mean(scores, scenes) for group, scenes in groups.items()},
    )


def _mean(values: Mapping[str, float], names: Sequence[str]) -> float | None:
    there = [values[name] for name in names if name in values]
    return sum(there) / len(there) if there else None


def _start(
    suite: Suite, entry: MethodEntry, photo: ImageRef, size: Size | None, limit: int, threads: int
) -> MethodProcess:
    try:
        return MethodProcess(*suite.texts(entry), photo, size, limit, threads)
    except EvalError as error:
        raise EvalError(f"method {entry.name!r}: {error}{suite.origin(entry)}") from error


def _times(starts: Sequence[Callable[[], MethodProcess]], repeats: int, warmup: int) -> list[list[float]]:
    """Seconds of each method's repetitions, in its order; each method has a process of its own."""

    def workload(name: str, method: MethodProcess) -> Workload:
        return Workload(name, name, lambda: (method.run(), {}))

    with ExitStack() as stack:
        methods = [stack.enter_context(start()) for start in starts]
        workloads = [workload(str(i), method) for i, method in enumerate(methods)]
        samples, _ = interleaved(workloads, warmup, repeats)
    return [samples[w.name] for w in workloads]
