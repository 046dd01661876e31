"""Work in several processes, which end with the one that started them, however that one ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import TypeVar

import cv2

from elf_eval.errors import EvalError

T = TypeVar("T")
R = TypeVar("R")


def run_all(work: Callable[[T], R], items: Iterable[T], workers: int, threads: int | None) -> Iterator[R]:
    """`work` on each item, with the results in order; in this process where `workers` is 1.

    Where the results are no longer wanted (an error, Ctrl-C, SIGTERM), the processes are ended at once, in the
    middle of their work.

    Raises
    ------
    EvalError
        If a process ends before its work is done, as when memory runs out.
    """
    if workers == 1:
        set_threads(threads)
        yield from map(work, items)
        return
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, _start, (threads,))
    try:
        yield from pool.map(work, items)
    except BrokenProcessPool as error:
        raise EvalError(
            f"one of the {workers} processes ended before its work was done (out of memory?); "
            "the same command goes on from here, with fewer --workers where memory is short"
        ) from error
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def set_threads(threads: int | None) -> None:
    """OpenCV's threads in this process; None is all cores."""
    cv2.setNumThreads(threads or os.cpu_count() or 1)


def _start(threads: int | None) -> None:
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of a terminal; the parent decides
    set_threads(threads)


def end_with_parent() -> None:
    """Let this process end as soon as the one that started it has.

    By itself a process that waits for work notices only when its pipes are closed, and a pool's workers hold the ends
    of each other's pipes.  One at work does not notice at all.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_watch, args=(parent.sentinel,), daemon=True).start()


def _watch(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
