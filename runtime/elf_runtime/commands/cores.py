"""How a command shares the cores among images at once, the network's threads and OpenCV's."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2

from elf_runtime.timing.environment import usable_cores

MOST_WORKERS = 4  # by default: each takes the memory of an image on its way through the network


def shared_cores(
    workers: int | None, threads: int | None, images: int | None, large: bool = False
) -> tuple[int, int | None]:
    """Images at once, and threads of the network for each, of what the user gave (None: nothing).

    Parameters
    ----------
    images : int, optional
        How many there are, if that is known.
    large : bool
        Whether they go through the network one after the other: it then has all cores, while the next is decoded.

    Returns
    -------
    (workers, threads)
        Threads are None, one per core, where there is one worker.
    """
    cores = usable_cores()
    if large and images != 1:
        return workers or 2, threads
    if workers is None:
        workers = 1 if images == 1 else max(1, min(MOST_WORKERS, cores // (threads or 1)))
    if threads is None and workers > 1:
        threads = max(1, cores // workers)
    return workers, threads


@contextmanager
def opencv_threads(count: int | None) -> Iterator[None]:
    """Have OpenCV use so many threads meanwhile; None leaves it as it is."""
    before = cv2.getNumThreads()
    try:
        if count is not None:
            cv2.setNumThreads(count)
        yield
    finally:
        cv2.setNumThreads(before)
