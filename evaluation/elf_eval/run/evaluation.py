"""Evaluation: which pairs of features a run measures, and what a worker does with one of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from elf_eval.data import Dataset, Pair
from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.features import ImageFeatures
from elf_eval.fingerprint import code_digest
from elf_eval.metrics.family import Record
from elf_eval.metrics.pair import CODE, pair_metrics, rounded
from elf_eval.protocol import Protocol
from elf_runtime import ElfError

from .cache import load
from .extraction import CachedFeatures
from .refinement import CODE as REFINED
from .refinement import refined_points


@dataclass(frozen=True)
class PairEvaluation:
    """One method on one pair, as plain data that can be sent to another process.

    Attributes
    ----------
    first, second : Path
        The cached features.
    limits : (int, int)
        How many of each image's features are used: the strongest.
    key : str
        Digest of all that the metrics depend on.
    """

    pair: Pair
    method: str
    counts: str
    first: Path
    second: Path
    limits: tuple[int, int]
    protocol: Protocol
    key: str


def evaluate_pair(evaluation: PairEvaluation) -> Record:
    """The pair's metrics, from the cached features alone, or with the images where the protocol refines matches."""
    paths = (evaluation.first, evaluation.second)
    first, second = (_load(path).first(limit) for path, limit in zip(paths, evaluation.limits, strict=True))
    pair, protocol = evaluation.pair, evaluation.protocol
    try:
        refined = partial(refined_points, first, second, pair.pixels(protocol.size)) if protocol.refine else None
        return rounded(pair_metrics(first, second, pair.truth, protocol, refined))
    except (EvalError, ElfError) as error:
        raise EvalError(f"{pair.name}: {error}") from error


def _load(path: Path) -> ImageFeatures:
    found = load(path)
    if found is None:
        raise EvalError(f"{path}: cached features are gone; run again")
    return found


def pair_evaluations(
    protocols: Mapping[str, Protocol],
    dataset: Dataset,
    features: Mapping[tuple[str, ImageRef], CachedFeatures],
) -> Iterator[PairEvaluation]:
    """One for each pair, way of counting and method, in that order.

    Parameters
    ----------
    protocols : mapping
        Each method's: they differ by `Protocol.ratio` and `refine` alone.
    features : mapping
        By method and image.
    """
    shared = next(iter(protocols.values()))
    settings = {method: _settings(protocol) for method, protocol in protocols.items()}
    pixels = cache(lambda ref: ref.digest(shared.size))
    for pair in dataset.pairs:
        refs = (pair.first, pair.second)
        for counts in shared.counts:
            for method, protocol in protocols.items():
                first, second = (features[method, ref] for ref in refs)
                limit1, limit2 = (
                    max(shared.count_floor, min(features[m, ref].count for m in protocols))
                    if counts == "equal"
                    else shared.max_keypoints
                    for ref in refs
                )
                parts = [settings[method], first.digest, second.digest, [limit1, limit2], pair.truth.identity()]
                if protocol.refine:
                    parts += [pixels(ref) for ref in refs]
                key = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
                yield PairEvaluation(pair, method, counts, first.path, second.path, (limit1, limit2), protocol, key)


def _settings(protocol: Protocol) -> str:
    """What a pair's metrics depend on, beside its features and ground truth."""
    code = code_digest(*(REFINED if protocol.refine else CODE))
    return json.dumps([protocol.to_dict() | {"counts": None, "count_floor": None}, code])
