"""What the workers do: features of an image, metrics of a pair. Plain functions of data that can be sent."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from elf_eval.data import Pair
from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import Method, open_methods
from elf_eval.metrics.pair import Record, pair_metrics
from elf_eval.protocol import Protocol
from elf_runtime import ElfError

from .cache import Extracted, FeatureCache, load
from .results import rounded


@dataclass(frozen=True)
class ExtractJob:
    """One method on one image."""

    detector: str
    descriptor: str | None
    threads: int | None
    ref: ImageRef
    protocol: Protocol
    cache: Path


@dataclass(frozen=True)
class ExtractDone:
    """Where the features are, and what they are."""

    path: Path
    digest: str
    count: int
    seconds: float


@dataclass(frozen=True)
class PairJob:
    """One pair of feature files; `limits` is how many of each image's features are used."""

    first: Path
    second: Path
    limits: tuple[int, int]
    pair: Pair
    protocol: Protocol


_open: dict[tuple[str, str | None, int | None], Method] = {}


def run_extract(job: ExtractJob) -> ExtractDone:
    """Features into the cache.  A worker keeps its last job's method open, no other: memory is flat."""
    key = (job.detector, job.descriptor, job.threads)
    if key not in _open:
        _open.clear()
        _open[key] = open_methods(*key)
    try:
        path, found = FeatureCache(job.cache).get(_open[key], job.ref, job.protocol)
    except (EvalError, ElfError) as error:
        raise EvalError(f"{job.ref.name}: {error}") from error
    return ExtractDone(path, found.digest(), len(found.features), found.seconds)


def run_pair(job: PairJob) -> Record:
    """The pair's metrics, from the cached features alone."""
    first, second = (_limited(p, n) for p, n in zip((job.first, job.second), job.limits, strict=True))
    try:
        return rounded(pair_metrics(first, second, job.pair.truth, job.protocol))
    except EvalError as error:
        raise EvalError(f"{job.pair.name}: {error}") from error


def _limited(path: Path, count: int) -> Extracted:
    found = load(path)
    if found is None:
        raise EvalError(f"{path}: cached features are gone; run again")
    return Extracted(found.features.first(count), found.size, found.to_working, found.seconds)
