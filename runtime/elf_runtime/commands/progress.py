"""How far a command has come: a bar on a terminal where tqdm is installed, else a line for each thing that is done."""

from __future__ import annotations

import sys
from typing import Any, TextIO

from .command import report
from .terminal import say


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
        self._bar = None if quiet or total == 1 else _bar(unit, total)

    def done(self, line: str) -> None:
        if self._bar is not None:
            self._bar.update()
        elif not self._quiet:
            say(line, self._lines)
            self._lines.flush()

    def advance(self) -> None:
        """One more is done, and there is nothing to say of it."""
        if self._bar is not None:
            self._bar.update()

    def failed(self, error: str) -> None:
        """Say an error; what it is of is done all the same, and counts by `advance`."""
        if self._bar is not None:
            self._bar.clear()
        report(self._command, error)
        if self._bar is not None:
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
