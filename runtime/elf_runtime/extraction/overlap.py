"""Work on many items by several threads, with the results in the items' order and memory for a few of them only."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def overlapped(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    workers: int,
    alone: Callable[[Item], Hashable] | None = None,
) -> Iterator[tuple[Item, Result]]:
    """``(item, work(item))`` in the order of the items, which are taken as they are needed.

    At most ``2 * workers`` items are taken and not given back yet.  Where it ends early, because `work` raised or
    nobody wants more, what runs is finished, and what waits is not begun.

    Parameters
    ----------
    work : callable
        Called from `workers` threads at once; from the caller's own where there is one worker.
    alone : callable, optional
        Items for which it gives the same are worked on one after the other.
    """
    if workers == 1:
        for item in items:
            yield item, work(item)
        return
    pool = ThreadPoolExecutor(workers, thread_name_prefix="elf")
    waiting: deque[tuple[Item, Future[Result]]] = deque()
    try:
        for item in items:
            while len(waiting) >= 2 * workers or (alone and alone(item) in {alone(other) for other, _ in waiting}):
                first, future = waiting.popleft()
                yield first, future.result()
            waiting.append((item, pool.submit(work, item)))
        while waiting:
            first, future = waiting.popleft()
            yield first, future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
