"""Work by several threads: the order of the results, how much is under way at once, and what an end leaves."""

from __future__ import annotations

import threading
import time

import pytest

from elf_runtime.extraction.overlap import overlapped


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_come_in_the_order_of_the_items(workers: int) -> None:
    def slower_first(i: int) -> int:
        time.sleep(0.002 * (10 - i))
        return i * i

    assert list(overlapped(slower_first, range(10), workers)) == [(i, i * i) for i in range(10)]
    assert list(overlapped(slower_first, [], workers)) == []


def test_so_many_run_at_once() -> None:
    together = threading.Barrier(3, timeout=20)  # passes only where three threads wait at it
    assert [result >= 0 for _, result in overlapped(lambda _: together.wait(), range(6), 3)] == [True] * 6


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_items_are_taken_as_they_are_needed(workers: int) -> None:
    taken: list[int] = []

    def items() -> object:
        for i in range(100):
            taken.append(i)
            yield i

    for given, _ in enumerate(overlapped(lambda i: i, items(), workers), start=1):
        assert len(taken) - given <= 2 * workers


def test_items_that_must_not_meet() -> None:
    inside: set[int] = set()
    order: list[int] = []

    def work(i: int) -> None:
        key = i // 5
        assert key not in inside
        inside.add(key)
        time.sleep(0.001)
        order.append(i)
        inside.remove(key)

    list(overlapped(work, range(20), 4, alone=lambda i: i // 5))
    for key in range(4):
        assert [i for i in order if i // 5 == key] == list(range(5 * key, 5 * key + 5))


@pytest.mark.parametrize("workers", [1, 3])
def test_an_error_ends_it_and_what_waits_is_not_begun(workers: int) -> None:
    begun: list[int] = []

    def work(i: int) -> None:
        begun.append(i)
        time.sleep(0.005)
        if i == 2:
            raise KeyError(i)

    with pytest.raises(KeyError):
        list(overlapped(work, range(1000), workers))
    assert len(begun) < 20
    now = len(begun)
    time.sleep(0.05)
    assert len(begun) == now
