"""What a worker of many does: the features of a shard's images, written as one file; the same file whoever writes it.

A worker may die at any moment, and its shard is then done by another from its beginning.  So that an image which kills
workers ends no run, a shard that is begun leaves a note beside it.  Who finds the note takes care: it notes each image
before it touches it, and leaves out those that were the last thing that `MOST_DEATHS` workers noted.  A note is of its
run alone: workers that another run left behind were stopped with it, and no image is to blame.
"""

from __future__ import annotations

import json
import pickle
import secrets
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import cv2
import numpy.typing as npt

import elf_runtime
from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ElfError, first_line
from elf_runtime.params import DetectionParams
from elf_runtime.results.features import Features

from .frames import Frame, Opened
from .outcome import detected, failure, record_of_image
from .overlap import overlapped
from .shards import digest, write_shard
from .store import Store

MOST_DEATHS = 2
READERS = 4  # images that are fetched while another one is worked on


@dataclass(frozen=True)
class Job:
    """What all shards of a run have in common; see `Extractor`.

    Attributes
    ----------
    run : str
        Tells this run from any other one.
    """

    elf: ElfRuntime
    params: DetectionParams
    descriptor: str | None
    mask: npt.NDArray[Any] | None
    record: Mapping[str, Any]
    store: Store
    ignore_exif: bool = False
    max_pixels: int | None = None
    threads: int = 1
    run: str = field(default_factory=partial(secrets.token_hex, 8))


@dataclass(frozen=True)
class Task:
    """A shard that is to be made.

    Attributes
    ----------
    shard : str
        Name of its file.
    known : mapping
        Name of an image -> the shards that have it already, each with the `digest` of its record there.
    """

    shard: str
    frames: Sequence[Frame]
    known: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


def work(job: Job, task: Task) -> dict[str, Any]:
    """Make a shard.

    Returns
    -------
    dict
        ``results``: what became of each image, as of an `Extractor`, with its ``name``; ``deaths``: how many workers
        of this run had begun this shard and not finished it.

    Raises
    ------
    ElfError
        If the shard can't be written, or the model is another one here.
    """
    if job.elf.sha256 != job.record["model_sha256"]:
        raise ElfError("the model of this worker is not the one of the command: install the same package everywhere")
    cv2.setNumThreads(job.threads)
    notes = _Notes(job.store, f".{task.shard}.{job.run}.begun")
    rows: dict[str, Features] = {}
    results = [_result(job, task, frame, opened, rows) for frame, opened in _opened(job, task, notes)]
    notes.add_careful("")  # no image is to blame from here on
    if rows:
        write_shard(job.store, task.shard, rows)
    notes.remove()
    return {"results": results, "deaths": notes.deaths}


def _opened(job: Job, task: Task, notes: _Notes) -> Iterator[tuple[Frame, Opened | ElfError]]:
    """The images in their order, several of them fetched ahead; with an error those that can't be read or kill."""

    def fetch(frame: Frame) -> Opened | ElfError:
        name = frame.stem.as_posix()
        if notes.killed(name) >= MOST_DEATHS:
            return ElfError(f"{frame.name}: {MOST_DEATHS} workers died of it; out of memory, perhaps")
        notes.add_careful(name)
        try:
            return frame.open(job.max_pixels)
        except Exception as error:  # whatever it is, it is this image's
            return ElfError(_text(error))

    # With care it is one after the other, so that the last one noted is the one that is worked on.
    return overlapped(fetch, task.frames, 1 if notes.deaths else READERS)


def _result(job: Job, task: Task, frame: Frame, image: Opened | ElfError, rows: dict[str, Features]) -> dict[str, Any]:
    """What became of an image, whose features come into `rows`."""
    name = frame.stem.as_posix()
    try:
        if isinstance(image, ElfError):
            raise image
        start = time.perf_counter()
        record = record_of_image(job.record, frame, image)
        _check_unicode(name, record["image"])
        for shard, there in task.known.get(name, {}).items():
            if there == digest(record):
                return {**frame.told(), "name": name, "files": [job.store.url(shard)], "skipped": True}
        pixels = image.decoded(job.ignore_exif)
        read = time.perf_counter() - start
        trace = job.elf.trace(pixels, mask=job.mask, params=job.params, descriptor=job.descriptor)
    except Exception as error:  # as above
        return failure(frame, ElfError(_text(error))) | {"name": name}
    rows[name] = replace(trace.features, record=record)
    found = detected(frame, [job.store.url(task.shard)], trace, time.perf_counter() - start, read)
    return found | {"name": name}


def _check_unicode(*names: str) -> None:
    try:
        "".join(names).encode()
    except UnicodeEncodeError:
        raise ElfError("its name, or that of its folder, is no Unicode, and shards take no other; rename it") from None


def _text(error: Exception) -> str:
    """What an error says; of one that is no answer to bad input, its type too."""
    if isinstance(error, (ElfError, OSError)):
        return str(error)
    kind, said = type(error).__name__, first_line(error)
    return kind if said == kind else f"{kind}: {said}"


class _Notes:
    """The note of who began a shard, a line of JSON each: null, then the names of what was touched with care."""

    def __init__(self, store: Store, name: str) -> None:
        self._store, self._name = store, name
        self._lines = (store.text(name) or "").splitlines()
        begun = [index for index, line in enumerate(self._lines) if line == "null"]
        self.deaths = len(begun)
        ends = [*begun[1:], len(self._lines)]
        last = [self._lines[end - 1] for end in ends[: len(begun)]]
        self._killed = Counter(json.loads(line) for line in last if line != "null")
        self._add(None)

    def killed(self, name: str) -> int:
        """How many workers noted this image as their last thing."""
        return self._killed[name]

    def add_careful(self, name: str) -> None:
        """Note what is touched next, if a worker has died of this shard."""
        if self.deaths:
            self._add(name)

    def _add(self, name: str | None) -> None:
        self._lines.append(json.dumps(name))
        self._store.put_text("\n".join(self._lines), self._name)

    def remove(self) -> None:
        self._store.remove(self._name)


class ShardWorker:
    """An actor of Ray Data: opens the model once, and makes a shard for each batch of one row.

    Parameters
    ----------
    version : str
        Of elf_runtime where the command runs.
    job : bytes
        A `Job`, pickled.
    """

    def __init__(self, version: str, job: bytes) -> None:
        self._version, self._data = version, job
        self._job: Job | None = None

    def __call__(self, batch: Mapping[str, Any]) -> dict[str, list[str]]:
        """``task`` (a pickled `Task`) -> ``report``: JSON of what `work` returns, or ``{"failed": why}``."""
        try:
            if self._version != elf_runtime.__version__:
                raise ElfError(f"this worker has elf-onnx {elf_runtime.__version__}, the command {self._version}")
            if self._job is None:
                self._job = pickle.loads(self._data)
            report = work(self._job, pickle.loads(batch["task"][0]))
        except Exception as error:  # Ray would give its own text, of many lines
            report = {"failed": _text(error)}
        return {"report": [json.dumps(report)]}
