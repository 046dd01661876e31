"""Extraction: what a worker does with one image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import Method, open_methods
from elf_eval.protocol import Protocol
from elf_runtime import ElfError

from .cache import FeatureCache


@dataclass(frozen=True)
class Extraction:
    """One method on one image, as plain data that can be sent to another process.

    Attributes
    ----------
    shared : bool
        See `methods.open_method`.
    """

    detector: str
    descriptor: str | None
    threads: int | None
    ref: ImageRef
    protocol: Protocol
    cache: Path
    shared: bool = False


@dataclass(frozen=True)
class CachedFeatures:
    """Where the features are, and what they are."""

    path: Path
    digest: str
    count: int
    seconds: float


_open: dict[tuple[str, str | None, int | None, bool], Method] = {}


def extract_features(extraction: Extraction) -> CachedFeatures:
    """Put the features into the cache.

    A worker keeps the method of its last extraction open and no other, so that its memory does not grow; methods that
    share their models are small, and stay.
    """
    key = (extraction.detector, extraction.descriptor, extraction.threads, extraction.shared)
    if key not in _open:
        if not extraction.shared:
            _open.clear()
        _open[key] = open_methods(*key)
    ref = extraction.ref
    try:
        path, found = FeatureCache(extraction.cache).get(_open[key], ref, extraction.protocol)
    except (EvalError, ElfError) as error:
        raise EvalError(f"{ref.name}: {error}") from error
    return CachedFeatures(path, found.digest(), len(found.features), found.seconds)
