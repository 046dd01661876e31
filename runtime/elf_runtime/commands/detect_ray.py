"""elf-detect --engine ray: images of any place that fsspec reaches, as shards of their features, by many workers."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from elf_runtime.errors import SettingError
from elf_runtime.extraction.frames import Frame, Still
from elf_runtime.extraction.ray_engine import SHARD_SIZE, plan, ray_library, ray_session, run_tasks, workers_for
from elf_runtime.extraction.remote import remote_images
from elf_runtime.extraction.shard_worker import Job
from elf_runtime.extraction.shards import contents, torn_shards, without
from elf_runtime.extraction.store import Store, is_url, needed
from elf_runtime.image.video import VIDEO_SUFFIXES

from . import command, options
from .command import UsageError
from .detect_report import Run, lines_of, record_of
from .inputs import IMAGE_SUFFIXES, image_files
from .outputs import check_outputs
from .progress import Progress
from .terminal import say

ERRORS = "errors.jsonl"


def work(args: argparse.Namespace) -> int:
    """Do what the command line says; its exit status.

    Raises
    ------
    UsageError
        If it asks for what is not for many machines, or for an output with shards in it, unless it says what of them.
    """
    _check(args)
    ray_library()
    for module in ("fsspec", "pyarrow"):
        needed(module)
    if args.format == "h5":
        needed("h5py", "h5")
    frames = _frames(args)
    store = Store.at(str(args.output) if is_url(args.output) else os.path.abspath(args.output))
    _check_shards(args, store)
    args.threads = args.threads or 1
    elf, mask = options.open_runtime(args), options.read_mask(args)
    params, record = options.params(elf, args), record_of(elf, args, mask)
    job = Job(elf, params, args.descriptor, mask, record, store, args.ignore_exif, args.max_pixels, args.threads)
    replaced = store.shards() if args.overwrite else torn_shards(store)
    known = contents(store, but=replaced) if args.skip_existing else {}
    to_stdout = "-" in (args.json, args.jsonl)
    stream = sys.stderr if to_stdout else sys.stdout
    progress = Progress("elf-detect", "image", len(frames), stream, args.quiet)
    run, done = Run(args, params, mask is not None, progress), _Done(known)
    with ExitStack() as stack:
        stack.callback(progress.close)
        ray = stack.enter_context(ray_session())
        workers = _workers(ray, args)
        size = args.shard_size or max(1, min(SHARD_SIZE, -(-len(frames) // workers)))
        tasks = plan(frames, record, store, args.format or "parquet", size, known)
        lines = stack.enter_context(lines_of(args.jsonl)) if args.jsonl else None
        for report in run_tasks(ray, job, tasks, workers):
            done.deaths += report["deaths"]
            for result in report["results"]:
                run.take(result, lines)
                done.take(result)
    done.finish(store, replaced)
    run.finish(elf)
    if done.deaths and not args.quiet:
        say(f"{done.deaths} times a worker had died in a shard, which was done anew", stream)
    return command.FAILED if run.failed else 0


class _Done:
    """What a run leaves in its output beside its own shards."""

    def __init__(self, known: Mapping[str, Mapping[str, str]]) -> None:
        self._known = known
        self._superseded: dict[str, set[str]] = {}  # shard -> images that another one has now, or that can't be done
        self._errors: list[Mapping[str, Any]] = []
        self.deaths = 0

    def take(self, result: Mapping[str, Any]) -> None:
        if "error" in result:
            self._errors.append(result)
        shard = result["files"][0].rpartition("/")[2] if "files" in result else None
        for other in self._known.get(result["name"], {}):
            if other != shard:
                self._superseded.setdefault(other, set()).add(result["name"])

    def finish(self, store: Store, replaced: Sequence[str]) -> None:
        """Remove the shards that are `replaced`, and of others what is superseded; write the errors of this run."""
        for shard in replaced:
            store.remove(shard)
        for shard, names in self._superseded.items():
            without(store, shard, names)
        for name in store.names():  # of workers that died or were stopped
            if name.startswith(".part-") and name.endswith((".part", ".begun")):
                store.remove(name)
        if self._errors:
            store.put_text("".join(json.dumps(error) + "\n" for error in self._errors), ERRORS)
        else:
            store.remove(ERRORS)


def _check(args: argparse.Namespace) -> None:
    """Refuse what this engine does not do."""
    videos = [word for word in args.images if Path(word).suffix.lower() in VIDEO_SUFFIXES and not os.path.isdir(word)]
    if videos or args.camera is not None or args.every != 1 or args.limit is not None:
        raise UsageError("--engine ray is for images; videos, --camera, --every and --limit are for --engine local")
    if args.picture or args.explain:
        raise UsageError("--engine ray draws no pictures; leave out --picture and --explain")
    if not args.images:
        raise UsageError("nothing to detect in: give images, folders, patterns or URLs")
    if args.json == args.jsonl == "-":
        raise UsageError("--json - and --jsonl - can't both have standard output")
    check_outputs(
        {"--json": [args.json], "--jsonl": [args.jsonl]},
        {
            "an input image": [word for word in args.images if not is_url(word)],
            "the mask": [args.mask],
            "the model": [args.model],
        },
        made=None if is_url(args.output) else args.output,
    )


def _frames(args: argparse.Namespace) -> list[Frame]:
    """The images that the command line names, sorted by their names among the results."""
    base_url = is_url(args.base)
    found: list[Frame] = [*_local(args, None if base_url else args.base)]
    found += _remote(args, args.base if base_url else None)
    frames: dict[str, Frame] = {}
    for frame in found:
        name = frame.stem.as_posix()
        if frames.setdefault(name, frame).name != frame.name:
            raise UsageError(f"{frame.name} and {frames[name].name} would both be {name}; give --base")
    return [frames[name] for name in sorted(frames)]


def _local(args: argparse.Namespace, base: Path | None) -> Iterator[Still]:
    """Images of this file system, which all machines share; named as elf-detect's files are, with their endings."""
    words = [word for word in args.images if not is_url(word)]
    found = image_files(words, args.recursive, base) if words else {}
    for path, name in found.items():
        yield Still(Path(os.path.abspath(path)), name.with_name(path.name))


def _remote(args: argparse.Namespace, base: str | None) -> Iterator[Frame]:
    for url in filter(is_url, args.images):
        found = remote_images(url, args.recursive, IMAGE_SUFFIXES, base)
        if not found:
            raise UsageError(f"{url}: no images there; --recursive looks below a folder")
        yield from found


def _check_shards(args: argparse.Namespace, store: Store) -> None:
    """Refuse an output that has shards, unless it is said what becomes of them."""
    shards = store.shards()
    if shards and not (args.skip_existing or args.overwrite):
        raise UsageError(
            f"-o {store.place}: {len(shards)} shards are there; --skip-existing adds what they lack, --overwrite "
            "replaces them, or give another folder"
        )
    if args.skip_existing and args.overwrite:
        raise UsageError("--skip-existing keeps the shards that are there and --overwrite replaces them; give one")


def _workers(ray: Any, args: argparse.Namespace) -> int:
    try:
        return workers_for(ray, args.workers, args.threads)
    except SettingError as error:
        raise UsageError(f"--threads {args.threads}: {error}") from error
