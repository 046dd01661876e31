"""A run: the features of every image, then the metrics of every pair.  What an earlier run left is used."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from elf_eval.data import Dataset, is_of, open_dataset
from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import open_methods
from elf_eval.protocol import Protocol
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite

from .evaluation import PairEvaluation, evaluate_pair, pair_evaluations
from .extraction import CachedFeatures, Extraction, extract_features
from .pair_log import PairLog
from .progress import Progress
from .provenance import about_dataset, about_method, now, versions
from .results import PairResult, Results
from .same_keypoints import check_keypoints
from .workers import run_all

Features = dict[tuple[str, ImageRef], CachedFeatures]  # by method and image


@dataclass(frozen=True)
class _Usable:
    """A method that can be opened."""

    entry: MethodEntry
    fingerprint: str
    protocol: Protocol  # with the method's own ratio and refinement


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
    suite: Suite,
    resources: Resources,
    log: Path | None = None,
    scenes: Collection[str] | None = None,
    shared: bool = False,
) -> Results:
    """Evaluate every method of `suite` on every pair of its datasets.

    Parameters
    ----------
    log : Path, optional
        Finished pairs are appended to this file as they come; the first one makes its folder.  A run that was
        interrupted goes on from it.
    scenes : names, optional
        Only the pairs of these scenes.
    shared : bool
        The methods are settings of few models: every image goes through each network once, and then through them all.
        The results' times are then not those of each method.

    Raises
    ------
    EvalError
        If a dataset or method can't be opened, a picture is of a pair or a group of scenes that no dataset has, or an
        image or pair can't be evaluated.
    """
    datasets, absent = open_datasets(suite)
    if scenes is not None:
        datasets = [(entry, dataset.only(scenes)) for entry, dataset in datasets]
    refs = list(dict.fromkeys(ref for _, dataset in datasets for ref in dataset.images()))
    methods, skipped = _usable(suite, resources, refs, shared)
    _try_keypoints(suite, [method.entry for method in methods], refs, resources)
    features = _extract(suite, [method.entry for method in methods], refs, resources, shared)
    finished = PairLog(log)
    pairs: list[PairResult] = []
    for entry, dataset in datasets:
        protocols = {method.entry.name: method.protocol for method in methods}
        evaluations = list(pair_evaluations(protocols, dataset, features))
        pairs += _evaluate(entry.name, evaluations, resources, finished)
    return Results(
        protocol=suite.protocol.to_dict(),
        methods=[about_method(m.entry, m.fingerprint, m.protocol, _seconds(features, m.entry.name)) for m in methods],
        skipped=[*absent, *skipped],
        datasets=[about_dataset(entry, dataset, suite.protocol.size) for entry, dataset in datasets],
        versions=versions(),
        created=now(),
        pairs=pairs,
    )


def extracted(
    suite: Suite, refs: Sequence[ImageRef], resources: Resources
) -> tuple[dict[str, Protocol], Features, list[dict[str, str]]]:
    """By every method that can be opened, its protocol and the images' features; and which can't, with the reasons.

    For what takes each keypoint where it was detected.

    Raises
    ------
    EvalError
        As `run`; if a method's matches are to be refined.
    """
    methods, skipped = _usable(suite, resources, refs, shared=False)
    if refined := [method.entry.name for method in methods if method.protocol.refine]:
        raise EvalError(
            f"method {refined[0]!r}: refine=true moves the points of a pair's matches, but structure from motion has "
            "one place for each keypoint; leave it out"
        )
    entries = [method.entry for method in methods]
    _try_keypoints(suite, entries, list(refs), resources)
    features = _extract(suite, entries, list(refs), resources, shared=False)
    return {method.entry.name: method.protocol for method in methods}, features, skipped


def _seconds(features: Features, method: str) -> list[float]:
    """Of each image."""
    return [done.seconds for (name, _), done in features.items() if name == method]


def open_datasets(suite: Suite) -> tuple[list[tuple[DatasetEntry, Dataset]], list[dict[str, str]]]:
    """The suite's datasets with their entries; the optional ones that can't be opened, with the reasons.

    Of an optional dataset the scenes that are whole are taken, and the others are named with their reasons.

    Raises
    ------
    EvalError
        If another can't be opened, or none is left; if a picture is of a pair or a group of scenes that none has.
    """
    opened: list[tuple[DatasetEntry, Dataset]] = []
    absent: list[dict[str, str]] = []
    left_out: dict[str, set[str]] = {}
    for entry in suite.datasets:
        missing: dict[str, str] = {}  # by scene; "" is the whole
        incomplete: dict[str, str] = {}
        try:
            opened.append((entry, open_dataset(suite.expand(entry.spec), incomplete if entry.optional else None)))
        except EvalError as error:
            if not entry.optional:
                raise EvalError(f"{error}{suite.origin(entry)}") from error
            missing = {"": str(error)} if not incomplete else {}
        left_out[entry.name] = set(incomplete)
        for scene, why in (missing | incomplete).items():
            name = f"{entry.name}/{scene}".rstrip("/")
            absent.append({"name": name, "reason": suite.unexpand(why)})
            print(f"left out: dataset {name!r}: {why}{suite.origin(entry)}", file=sys.stderr)
    if not opened:
        raise EvalError("\n".join(["none of the datasets is there", *(a["reason"] for a in absent)]))
    _check_pictures(suite, {entry.name: dataset for entry, dataset in opened}, left_out)
    suite.check_groups({scene for _, dataset in opened for scene in dataset.scenes()})
    return opened, absent


def _check_pictures(suite: Suite, datasets: Mapping[str, Dataset], left_out: Mapping[str, Collection[str]]) -> None:
    for picture in suite.pictures:
        if picture.dataset not in datasets or is_of(picture.pair, left_out[picture.dataset]):  # optional, not there
            continue
        try:
            datasets[picture.dataset].pair(picture.pair)
        except EvalError as error:
            raise EvalError(f"picture {picture.pair!r}: {error}") from error


def _usable(
    suite: Suite, resources: Resources, refs: Sequence[ImageRef], shared: bool
) -> tuple[list[_Usable], list[dict[str, str]]]:
    """The methods that can be opened and have all they need of the images; the optional ones without, with reasons."""
    usable, skipped = [], []
    failed: list[str] = []
    left_out: list[str] = []
    for entry in suite.methods:
        try:
            method = open_methods(*suite.texts(entry), resources.threads, shared)
            method.check(refs)
            usable.append(_Usable(entry, method.fingerprint, method.protocol(suite.protocol)))
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


def _try_keypoints(suite: Suite, entries: list[MethodEntry], refs: list[ImageRef], resources: Resources) -> None:
    """Let methods that describe another's keypoints be checked on the first image, before the work on all of them."""
    there = {entry.name for entry in entries}
    bound = [entry for entry in entries if entry.keypoints_of in there]
    wanted = {name for entry in bound for name in (entry.name, entry.keypoints_of)}
    if bound:
        _extract(suite, [entry for entry in entries if entry.name in wanted], refs[:1], resources, shared=False)


def _extract(
    suite: Suite, entries: list[MethodEntry], refs: list[ImageRef], resources: Resources, shared: bool
) -> Features:
    keys = [(entry, ref) for entry in entries for ref in refs]
    if shared:
        keys = [(entry, ref) for ref in refs for entry in entries]
    extractions = [
        Extraction(*suite.texts(entry), resources.threads, ref, suite.protocol, resources.cache, shared)
        for entry, ref in keys
    ]
    progress = Progress("features", len(extractions), quiet=resources.quiet)
    features: Features = {}
    cached = run_all(extract_features, extractions, resources.workers, resources.threads)
    for (entry, ref), done in zip(keys, cached, strict=True):
        features[entry.name, ref] = done
        if (of := features.get((entry.keypoints_of or "", ref))) is not None:
            check_keypoints(entry, ref, done, of)
        progress.step(f"{entry.name}: {ref.name}")
    return features


def _evaluate(
    dataset: str, evaluations: list[PairEvaluation], resources: Resources, log: PairLog
) -> Iterator[PairResult]:
    missing = [evaluation for evaluation in evaluations if evaluation.key not in log.done]
    progress = Progress(f"pairs of {dataset}", len(missing), quiet=resources.quiet)
    records = run_all(evaluate_pair, missing, resources.workers, resources.threads)
    for evaluation, record in zip(missing, records, strict=True):
        log.add(evaluation.key, record)
        progress.step(f"{evaluation.method}: {evaluation.pair.name}")
    for evaluation in evaluations:
        pair, record = evaluation.pair, log.done[evaluation.key]
        images = (pair.first.name, pair.second.name)
        yield PairResult(dataset, pair.scene, *images, evaluation.method, evaluation.counts, pair.parameter, record)
