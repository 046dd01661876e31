"""A run: features of every image, then metrics of every pair; what an earlier run left is used."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from elf_eval.data import Dataset, open_dataset
from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import open_methods
from elf_eval.protocol import Protocol
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite

from .jobs import ExtractJob, run_extract, run_pair
from .pair_log import PairLog
from .progress import Progress
from .results import PairResult, Results, now, versions
from .rows import Features, rows
from .workers import run_all


@dataclass(frozen=True)
class Resources:
    """What a run may use.

    Attributes
    ----------
    cache : Path
        Folder of the features.
    workers : int
        Processes.
    threads : int, optional
        Threads of each process; None is all cores.
    quiet : bool
        No progress lines.
    """

    cache: Path
    workers: int = 1
    threads: int | None = None
    quiet: bool = False


def run(suite: Suite, resources: Resources, log: Path | None = None, scenes: Collection[str] | None = None) -> Results:
    """Evaluate every method of `suite` on every pair of its datasets.

    Parameters
    ----------
    log : Path, optional
        Finished pairs are appended to this file as they come, the first of which makes its folder; an interrupted
        run that finds it goes on there.
    scenes : names, optional
        Only the pairs of these.

    Raises
    ------
    EvalError
        On a dataset or method that can't be opened, a picture of a pair that its dataset does not have, or an image
        or pair that can't be evaluated.
    """
    datasets = [(entry, _dataset(suite, entry)) for entry in suite.datasets]
    _check_pictures(suite, {entry.name: dataset for entry, dataset in datasets})
    if scenes is not None:
        datasets = [(entry, dataset.only(scenes)) for entry, dataset in datasets]
    methods, skipped = _usable(suite, resources)
    refs = list(dict.fromkeys(ref for _, dataset in datasets for ref in dataset.images()))
    features = _extract(suite, [entry for entry, _ in methods], refs, resources)
    pairs: list[PairResult] = []
    finished = PairLog(log)
    names = [entry.name for entry, _ in methods]
    for entry, dataset in datasets:
        pairs += _evaluate(suite.protocol, entry.name, dataset, names, features, resources, finished)
    return Results(
        protocol=suite.protocol.to_dict(),
        methods=[_about(entry, print_, features) for entry, print_ in methods],
        skipped=skipped,
        datasets=[_about_dataset(entry.name, entry.spec, dataset, suite) for entry, dataset in datasets],
        versions=versions(),
        created=now(),
        pairs=pairs,
    )


def _dataset(suite: Suite, entry: DatasetEntry) -> Dataset:
    try:
        return open_dataset(suite.expand(entry.spec))
    except EvalError as error:
        raise EvalError(f"{error}{suite.origin(entry)}") from error


def _check_pictures(suite: Suite, datasets: Mapping[str, Dataset]) -> None:
    for picture in suite.pictures:
        try:
            datasets[picture.dataset].pair(picture.pair)
        except EvalError as error:
            raise EvalError(f"picture {picture.pair!r}: {error}") from error


def _usable(suite: Suite, resources: Resources) -> tuple[list[tuple[MethodEntry, str]], list[dict[str, str]]]:
    """The methods that open, with their fingerprints, and the optional ones that don't, with the reason."""
    usable, skipped = [], []
    failed: list[str] = []
    left_out: list[str] = []
    for entry in suite.methods:
        try:
            usable.append((entry, open_methods(*suite.texts(entry), resources.threads).fingerprint))
        except EvalError as error:
            lines = left_out if entry.optional else failed
            lines.append(f"method {entry.name!r}: {error}{suite.origin(entry)}")
            skipped.append({"name": entry.name, "reason": suite.unexpand(str(error))})
    if failed:
        raise EvalError("\n".join(failed))
    if not usable:
        raise EvalError("\n".join(["none of the methods can be opened", *left_out]))
    for line in left_out:
        print(f"left out: {line}", file=sys.stderr)
    return usable, skipped


def _extract(suite: Suite, entries: list[MethodEntry], refs: list[ImageRef], resources: Resources) -> Features:
    keys = [(entry, ref) for entry in entries for ref in refs]
    jobs = [
        ExtractJob(*suite.texts(entry), resources.threads, ref, suite.protocol, resources.cache) for entry, ref in keys
    ]
    progress = Progress("features", len(jobs), quiet=resources.quiet)
    features: Features = {}
    results = run_all(run_extract, jobs, resources.workers, resources.threads)
    for (entry, ref), done in zip(keys, results, strict=True):
        features[entry.name, ref] = done
        progress.step(f"{entry.name}: {ref.name}")
    return features


def _evaluate(
    protocol: Protocol,
    name: str,
    dataset: Dataset,
    methods: list[str],
    features: Features,
    resources: Resources,
    log: PairLog,
) -> list[PairResult]:
    wanted = list(rows(protocol, dataset, methods, features))
    missing = [row for row in wanted if row.key not in log.done]
    progress = Progress(f"pairs of {name}", len(missing), quiet=resources.quiet)
    results = run_all(run_pair, [row.job for row in missing], resources.workers, resources.threads)
    for row, values in zip(missing, results, strict=True):
        log.add(row.key, values)
        progress.step(f"{row.method}: {row.pair.name}")
    return [
        PairResult(
            name,
            row.pair.scene,
            row.pair.first.name,
            row.pair.second.name,
            row.method,
            row.counts,
            row.pair.parameter,
            log.done[row.key],
        )
        for row in wanted
    ]


def _about(entry: MethodEntry, fingerprint: str, features: Features) -> dict[str, Any]:
    seconds = [done.seconds for (name, _), done in features.items() if name == entry.name]
    return {
        "name": entry.name,
        "detector": entry.detector,
        "descriptor": entry.descriptor,
        "paper": entry.paper,
        "fingerprint": hashlib.sha256(fingerprint.encode()).hexdigest(),
        "seconds_per_image": round(sum(seconds) / len(seconds), 4),
    }


def _about_dataset(name: str, spec: str, dataset: Dataset, suite: Suite) -> dict[str, Any]:
    refs = list(dataset.images())
    sha = hashlib.sha256()
    for ref in refs:
        sha.update(ref.digest(suite.protocol.size).encode())
    for pair in dataset.pairs:
        sha.update(json.dumps([pair.name, pair.truth.identity()]).encode())
    return {
        "name": name,
        "spec": spec,
        "parameter": dataset.parameter,
        "pairs": len(dataset.pairs),
        "scenes": len(dataset.scenes()),
        "images": len(refs),
        "sha256": sha.hexdigest(),
    }
