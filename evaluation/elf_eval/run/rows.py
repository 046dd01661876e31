"""The lines that a run's results will have, each with the job that fills it in and the key of its content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from elf_eval import geometry, metrics
from elf_eval.data import Dataset, Pair, truth
from elf_eval.data.images import ImageRef
from elf_eval.methods.base import code_digest
from elf_eval.metrics import pair as pair_metrics
from elf_eval.protocol import Protocol
from elf_runtime.checks import greedy, repeatability

from .jobs import ExtractDone, PairJob

Features = dict[tuple[str, ImageRef], ExtractDone]  # by method and image


@dataclass(frozen=True)
class Row:
    """A line of the results that is still to be filled in; rows of one `key` have the same values."""

    pair: Pair
    method: str
    counts: str
    job: PairJob
    key: str


def rows(protocol: Protocol, dataset: Dataset, methods: list[str], features: Features) -> Iterator[Row]:
    """One for each pair, way of counting and method, in that order."""
    files = [module.__file__ or "" for module in (geometry, greedy, pair_metrics, repeatability, truth)]
    code = code_digest(*files, *Path(metrics.__path__[0]).glob("*.py"))
    settings = json.dumps([protocol.to_dict() | {"counts": None, "count_floor": None}, code])
    for pair in dataset.pairs:
        images = (pair.first, pair.second)
        for counts in protocol.counts:
            for method in methods:
                found = [features[method, ref] for ref in images]
                limits = [
                    max(protocol.count_floor, min(features[m, ref].count for m in methods))
                    if counts == "equal"
                    else protocol.max_keypoints
                    for ref in images
                ]
                job = PairJob(found[0].path, found[1].path, (limits[0], limits[1]), pair, protocol)
                parts = [settings, found[0].digest, found[1].digest, limits, pair.truth.identity()]
                key = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
                yield Row(pair, method, counts, job, key)
