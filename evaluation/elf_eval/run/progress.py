"""A line that says how far a run is."""

from __future__ import annotations

import sys
import time
from typing import TextIO

_PATIENCE = 30.0  # seconds


class Progress:
    """Counts the steps of a stage: on a terminal in one line, elsewhere in a line every tenth of the way or 30 s."""

    def __init__(self, stage: str, total: int, stream: TextIO | None = None, quiet: bool = False) -> None:
        self._stage, self._total, self._quiet = stage, total, quiet
        self._stream = stream or sys.stderr
        self._done, self._tenth = 0, 0
        self._start = self._shown = time.monotonic()

    def step(self, what: str) -> None:
        """One more step is done; `what` it was."""
        self._done += 1
        tenth, now = 10 * self._done // max(1, self._total), time.monotonic()
        terminal = self._stream.isatty()
        if self._quiet or not (terminal or tenth > self._tenth or now - self._shown > _PATIENCE):
            return
        self._tenth, self._shown = tenth, now
        elapsed = now - self._start
        left = elapsed / self._done * (self._total - self._done)
        line = f"{self._stage} {self._done}/{self._total}  {elapsed:.0f} s, {left:.0f} s left  {what[:50]}"
        end = "\n" if not terminal or self._done == self._total else ""
        print(f"\r\x1b[K{line}" if terminal else line, end=end, file=self._stream, flush=True)
