"""The same extraction on many machines, by Ray Data: an actor for each worker, a task for each shard.

The images of a run, in their order, are cut into shards, and a shard's name says which run and which part.  A task
whose worker died is done again and writes the same file; so each image is in the output once.
"""

from __future__ import annotations

import json
import logging
import os
import pickle
import re
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import elf_runtime
from elf_runtime.errors import ElfError, SettingError, first_line

from .frames import Frame
from .shard_worker import Job, ShardWorker, Task
from .shards import digest
from .store import Store, needed, run_of

SHARD_SIZE = 256  # images; some 70 MB of features with 500 keypoints each

# What Ray and its processes read: its statistics are not sent; what it says of workers that died, on standard output
# and in colours, stays in its log files.
QUIET = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_DEDUP_LOGS_SKIP_REGEX": ".", "RAY_COLOR_PREFIX": "0"}

_COLOR = re.compile(r"\x1b\[[0-9;]*m")


def plan(
    frames: Sequence[Frame],
    record: Mapping[str, Any],
    store: Store,
    ending: str,
    size: int,
    known: Mapping[str, Mapping[str, str]],
) -> list[Task]:
    """The shards of a run: the same ones for the same images, settings and files that are there already."""
    images = [[frame.stem.as_posix(), frame.identity()] for frame in frames]
    there_already = store.shards()
    run = digest([ending, size, dict(record), elf_runtime.__version__, images, there_already])[:12]
    number = 1 + max(map(run_of, there_already), default=0)
    tasks = []
    for index, start in enumerate(range(0, len(frames), size)):
        part = frames[start : start + size]
        there = {name: known[name] for name in (frame.stem.as_posix() for frame in part) if name in known}
        tasks.append(Task(f"part-{number:04d}-{run}-{index:05d}.{ending}", part, there))
    return tasks


def ray_library() -> Any:
    """The module `ray`, with `QUIET` where the environment says nothing else; some of it is read as it is imported.

    Raises
    ------
    ElfError
        If Ray is not installed.
    """
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    needed("ray.data")
    return needed("ray")


@contextmanager
def ray_session() -> Iterator[Any]:
    """Ray, connected to the cluster that it finds (RAY_ADDRESS, or one that `ray start` began), else started here.

    One that the program has started itself is used as it is, and goes on.

    Raises
    ------
    ElfError
        If Ray is not installed, or can't connect or start.
    """
    ray = ray_library()
    if ray.is_initialized():
        yield ray
        return
    try:
        with _own_signals():
            ray.init(include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    except Exception as error:  # Ray's errors have no common base
        raise ElfError(f"Ray did not start: {first_line(error)}") from error
    try:
        yield ray
    finally:
        ray.shutdown()


@contextmanager
def _own_signals() -> Iterator[None]:
    """Keep what the program does on SIGTERM, which Ray replaces by exits of its own; also if it comes meanwhile."""
    before = signal.getsignal(signal.SIGTERM)
    is_main = threading.current_thread() is threading.main_thread()  # only there are signals received
    try:
        yield
    except SystemExit:
        if is_main:
            signal.signal(signal.SIGTERM, before)
            signal.raise_signal(signal.SIGTERM)
        raise
    finally:
        if is_main:
            signal.signal(signal.SIGTERM, before)


def workers_for(ray: Any, workers: int | None, threads: int) -> int:
    """How many workers of so many cores: by default as many as the cluster has cores for.

    Raises
    ------
    SettingError
        If not even one has room on the cluster.
    """
    cores = int(ray.cluster_resources().get("CPU", 0))
    most = sum(int(node["Resources"].get("CPU", 0)) // threads for node in ray.nodes() if node["Alive"])
    if most < 1:
        raise SettingError(f"a worker of {threads} cores has no room: Ray has {cores} on {len(ray.nodes())} machines")
    return workers or most


def run_tasks(ray: Any, job: Job, tasks: Sequence[Task], workers: int) -> Iterator[Mapping[str, Any]]:
    """What `work` returned for each task, in the order in which they end.

    Raises
    ------
    ElfError
        If a worker can't do its task for another reason than its death, or Ray fails.
    """
    context = ray.data.DataContext.get_current()
    context.enable_progress_bars = False
    logging.getLogger("ray.data").setLevel(logging.ERROR)
    rows = ray.data.from_items([{"task": pickle.dumps(task)} for task in tasks], override_num_blocks=len(tasks))
    reports = rows.map_batches(
        ShardWorker,
        fn_constructor_args=(elf_runtime.__version__, pickle.dumps(job)),
        batch_size=1,
        num_cpus=job.threads,
        # A shard is long work: none waits for one worker while another is idle.
        compute=ray.data.ActorPoolStrategy(size=min(workers, len(tasks)), max_tasks_in_flight_per_actor=1),
    )
    count = 0
    for row in _rows(reports):
        report = json.loads(row["report"])
        if "failed" in report:
            raise ElfError(report["failed"])
        count += 1
        yield report
    if count != len(tasks):
        raise ElfError(f"Ray gave the reports of {count} of {len(tasks)} shards")


def _rows(reports: Any) -> Iterator[Mapping[str, Any]]:
    try:
        yield from reports.iter_rows()
    except Exception as error:  # as above
        raise ElfError(f"Ray: {_said(error)}") from error


def _said(error: Exception) -> str:
    """What went wrong in a worker, or in Ray itself, in a line without the colours that Ray writes."""
    cause = getattr(error, "cause", None)
    return _COLOR.sub("", first_line(cause if isinstance(cause, Exception) else error))
