"""A sample of damaged models and images: only errors of the project's own come out, soon, and in little memory.

The long run is ``make mutants``.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import time
from collections.abc import Callable

import numpy as np
import pytest

from elf_runtime import ElfError
from helpers import TINY
from mutants import images, jobs, trial, wire
from mutants.trial import Outcome

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="each mutant has a forked process of its own")


def tried(kind: Callable[[int, int], object], count: int, part: int) -> list[Outcome]:
    """Every second of the mutants, from `part` on."""
    made = itertools.islice(kind(0, count), part, None, 2)  # type: ignore[call-overload]
    return [trial.trial(what, work) for what, work in made]


@pytest.mark.parametrize("part", [0, 1])
@pytest.mark.parametrize(("kind", "count"), [("elf_models", 180), ("picture_files", 120)])
def test_only_our_errors_come_out(kind: str, count: int, part: int) -> None:
    found = tried(getattr(jobs, kind), count, part)
    assert len(found) == count // 2
    assert [(o.what, o.fault) for o in found if o.fault] == []
    # Neither harmless nor hopeless, all of them.
    assert 0.2 < np.mean([o.refused for o in found]) < 0.95


def crash() -> None:
    ctypes.string_at(0)


def our_error() -> None:
    raise ElfError("this file is damaged")


def endless() -> None:
    time.sleep(60)


def hungry() -> None:
    np.ones(300_000_000, np.uint8)


def raw_error() -> None:
    raise ValueError("nobody expects it")


def unsafe_error() -> None:
    error = ElfError("x")
    error.__class__ = type("Odd", (ElfError,), {"__str__": lambda _: "\x1b[31m"})
    raise error


@pytest.mark.parametrize(
    ("work", "fault"),
    [(crash, "signal SIGSEGV"), (endless, "no end within 4 s"), (hungry, " MiB"), (raw_error, "ValueError: nobody"),
     (unsafe_error, "an error of 5 characters"), (our_error, ""), (lambda: None, "")],
)  # fmt: skip
def test_a_trial_tells_a_fault(monkeypatch: pytest.MonkeyPatch, work: Callable[[], None], fault: str) -> None:
    monkeypatch.setattr(trial, "SECONDS", 4.0)
    monkeypatch.setattr(trial, "BYTES", 250e6)
    outcome = trial.trial("it", work)
    assert fault in outcome.fault
    assert bool(fault) == bool(outcome.fault)
    assert outcome.refused == (work is our_error)


@pytest.mark.parametrize("kind", ["models", "files"])
def test_a_seed_gives_the_same_mutants(kind: str) -> None:
    def made(seed: int) -> list[bytes]:
        if kind == "models":
            return [data for _, data in itertools.islice(wire.mutants(TINY.read_bytes(), seed), 60)]
        return [data for _, _, data in itertools.islice(images.files(seed), 60)]

    assert made(1) == made(1)
    assert len({*made(1)} & {*made(2)}) < 10
    assert len({*made(1)}) > 50
