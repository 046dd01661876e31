"""One line that tells how far a run is."""

from __future__ import annotations

import sys
import time
from typing import TextIO


class Progress:
    """Counts steps of a stage: rewritten in place on a terminal, every tenth part elsewhere."""

    def __init__(self, stage: str, total: int, stream: TextIO | None = None, quiet: bool = False) -> None:
        self._stage, self._total, self._quiet = stage, total, quiet
        self._stream = stream or sys.stderr
        self._done, self._tenth, self._start = 0, 0, time.monotonic()

    def step(self, what: str) -> None:
        """One more is done; `what` it was."""
        self._done += 1
        tenth = 10 * self._done // max(1, self._total)
        terminal = self._stream.isatty()
        if self._quiet or not (terminal or tenth > self._tenth):
            return
        self._tenth = tenth
        elapsed = time.monotonic() - self._start
        left = elapsed / self._done * (self._total - self._done)
        line = f"{self._stage} {self._done}/{self._total}  {elapsed:.0f} s, {left:.0f} s left  {what[:50]}"
        end = "\n" if not terminal or self._done == self._total else ""
        print(f"\r\x1b[K{line}" if terminal else line, end=end, file=self._stream, flush=True)
