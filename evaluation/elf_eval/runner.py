"""A run: features of every image, then metrics of every pair; what an earlier run left is used."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import metrics, pair_metrics, truth
from .datasets import Dataset, Pair, open_dataset
from .errors import EvalError
from .images import ImageRef
from .jobs import ExtractDone, ExtractJob, PairJob, run_all, run_extract, run_pair
from .methods import open_methods
from .methods.base import code_digest
from .progress import Progress
from .results import PairResult, Results, now, versions
from .suite import MethodEntry, Suite

Features = dict[tuple[str, ImageRef], ExtractDone]


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


def run(
    suite: Suite, resources: Resources, log: Path | None = None, scenes: Collection[str] | None = None
) -> Results:
    """Evaluate every method of `suite` on every pair of its datasets.

    Parameters
    ----------
    log : Path, optional
        Finished pairs are appended to this file as they come; an interrupted run that finds it goes on there.
    scenes : names, optional
        Only the pairs of these.

    Raises
    ------
    EvalError
        On a dataset or method that can't be opened, or an image or pair that can't be evaluated.
    """
    datasets = [(entry, open_dataset(suite.expand(entry.spec))) for entry in suite.datasets]
    if scenes is not None:
        datasets = [(entry, dataset.only(scenes)) for entry, dataset in datasets]
    methods, skipped = _usable(suite, resources)
    refs = list(dict.fromkeys(ref for _, dataset in datasets for ref in dataset.images()))
    features = _extract(suite, [entry for entry, _ in methods], refs, resources)
    pairs: list[PairResult] = []
    done = _read_log(log)
    for entry, dataset in datasets:
        pairs += _evaluate(
            suite, entry.name, dataset, [m for m, _ in methods], features, resources, done, log
        )
    return Results(
        protocol=suite.protocol.to_dict(),
        methods=[_about(entry, print_, features) for entry, print_ in methods],
        skipped=skipped,
        datasets=[_about_dataset(entry.name, entry.spec, dataset, suite) for entry, dataset in datasets],
        versions=versions(),
        created=now(),
        pairs=pairs,
    )


def _usable(suite: Suite, resources: Resources) -> tuple[list[tuple[MethodEntry, str]], list[dict[str, str]]]:
    """The methods that open, with their fingerprints, and the optional ones that don't, with the reason."""
    opened = [(entry, *_fingerprint(suite, entry, resources.threads)) for entry in suite.methods]
    usable = [(entry, fingerprint) for entry, fingerprint, _ in opened if fingerprint]
    skipped = [{"name": entry.name, "reason": reason} for entry, _, reason in opened if reason]
    if not usable:
        raise EvalError(f"none of the methods can be opened: {[s['reason'] for s in skipped]}")
    return usable, skipped


def _fingerprint(suite: Suite, entry: MethodEntry, threads: int | None) -> tuple[str, str]:
    """The method's fingerprint, or "" and the reason why it can't be opened."""
    try:
        return open_methods(*_texts(suite, entry), threads).fingerprint, ""
    except EvalError as error:
        if not entry.optional:
            raise EvalError(f"method {entry.name!r}: {error}") from error
        return "", suite.unexpand(str(error))


def _texts(suite: Suite, entry: MethodEntry) -> tuple[str, str | None]:
    return suite.expand(entry.detector), suite.expand(entry.descriptor) if entry.descriptor else None


def _extract(
    suite: Suite, entries: list[MethodEntry], refs: list[ImageRef], resources: Resources
) -> Features:
    keys = [(entry, ref) for entry in entries for ref in refs]
    jobs = [
        ExtractJob(*_texts(suite, entry), resources.threads, ref, suite.protocol, resources.cache)
        for entry, ref in keys
    ]
    progress = Progress("features", len(jobs), quiet=resources.quiet)
    features: Features = {}
    results = run_all(run_extract, jobs, resources.workers, resources.threads)
    for (entry, ref), done in zip(keys, results, strict=True):
        features[entry.name, ref] = done
        progress.step(f"{entry.name}: {ref.name}")
    return features


@dataclass(frozen=True)
class _Row:
    """A line of the results that is still to be filled in."""

    pair: Pair
    method: str
    counts: str
    job: PairJob
    key: str


def _evaluate(
    suite: Suite,
    name: str,
    dataset: Dataset,
    methods: list[MethodEntry],
    features: Features,
    resources: Resources,
    done: dict[str, Any],
    log: Path | None,
) -> list[PairResult]:
    rows = list(_rows(suite, dataset, [m.name for m in methods], features))
    open_rows = [row for row in rows if row.key not in done]
    progress = Progress(f"pairs of {name}", len(open_rows), quiet=resources.quiet)
    results = run_all(run_pair, [row.job for row in open_rows], resources.workers, resources.threads)
    for row, values in zip(open_rows, results, strict=True):
        done[row.key] = values
        if log is not None:
            with open(log, "a") as file:
                file.write(json.dumps([row.key, values]) + "\n")
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
            done[row.key],
        )
        for row in rows
    ]


def _rows(suite: Suite, dataset: Dataset, methods: list[str], features: Features) -> Iterator[_Row]:
    protocol = suite.protocol
    code = code_digest(pair_metrics.__file__, truth.__file__, *Path(metrics.__path__[0]).glob("*.py"))
    settings = json.dumps([protocol.to_dict() | {"counts": None}, code])
    for pair in dataset.pairs:
        images = (pair.first, pair.second)
        for counts in protocol.counts:
            for method in methods:
                found = [features[method, ref] for ref in images]
                limits = [
                    min(features[m, ref].count for m in methods)
                    if counts == "equal"
                    else protocol.max_keypoints
                    for ref in images
                ]
                job = PairJob(found[0].path, found[1].path, (limits[0], limits[1]), pair, protocol)
                parts = [settings, found[0].digest, found[1].digest, limits, pair.truth.identity()]
                key = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
                yield _Row(pair, method, counts, job, key)


def _read_log(log: Path | None) -> dict[str, Any]:
    """Finished pairs by key; a line that an interruption cut short is left out."""
    done: dict[str, Any] = {}
    if log is None or not log.exists():
        return done
    for line in log.read_text().splitlines():
        try:
            key, values = json.loads(line)
        except ValueError:
            continue
        done[key] = values
    return done


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
