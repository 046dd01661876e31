"""How far a command has come: a bar on a terminal where tqdm is installed, else a line for each thing that is done."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, TextIO

from .command import report
from .terminal import say

_EVERY = 10.0  # seconds between lines of what is done, where there is no bar


class Progress:
    """Reports what is done of many things.

    Parameters
    ----------
    command : str
        Its name, for errors.
    unit : str
        What one of them is called, such as "image".
    total : int, optional
        How many there will be, if that is known.
    lines : stream
        Of the lines; the bar is on standard error.
    quiet : bool
        Errors only.
    """

    def __init__(self, command: str, unit: str, total: int | None, lines: TextIO, quiet: bool = False) -> None:
        self._command, self._lines, self._quiet = command, lines, quiet
        self._unit, self._total = unit, total
        self._bar = None if quiet or total in (0, 1) else _bar(unit, total)
        self._count, self._spoke = 0, time.monotonic()

    def done(self, line: str) -> None:
        """One more is done; its line only where there is no bar: what it is about lies in files."""
        if self._bar is not None:
            self._bar.update()
        elif not self._quiet:
            say(line, self._lines)
            self._lines.flush()

    def found(self, line: str) -> None:
        """One more is done, and this is its result: a line in any case, above the bar where there is one."""
        if not self._quiet:
            self._above(lambda: say(line, self._lines))
            self._lines.flush()
        self.advance()

    def step(self) -> None:
        """One more is done of what has no lines: where there is no bar, how far it is every ten seconds."""
        self._count += 1
        self.advance()
        if self._bar is None and not self._quiet and time.monotonic() - self._spoke > _EVERY:
            self._spoke = time.monotonic()
            of = "" if self._total is None else f" of {self._total}"
            say(f"{self._command}: {self._count}{of} {self._unit}s done", sys.stderr)

    def advance(self) -> None:
        """One more is done, and there is nothing to say of it."""
        if self._bar is not None:
            self._bar.update()

    def failed(self, error: str) -> None:
        """Say an error; what it is of is done all the same, and counts by `advance`."""
        self._above(lambda: report(self._command, error))

    def _above(self, say_it: Callable[[], None]) -> None:
        if self._bar is not None:
            self._bar.clear()
        say_it()
        if self._bar is not None:
            self._lines.flush()
            self._bar.refresh()

    def close(self, line: str = "") -> None:
        """End the bar, with a last line."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None
        if line and not self._quiet:
            say(line, self._lines)


def _bar(unit: str, total: int | None) -> Any:
    """A bar with rate and time left, where standard error is a terminal and tqdm is there; else None."""
    if not sys.stderr.isatty():
        return None
    try:
        from tqdm import tqdm
    except ImportError:
        return None
    return tqdm(total=total, unit=f" {unit}", file=sys.stderr, dynamic_ncols=True, mininterval=0.2)
