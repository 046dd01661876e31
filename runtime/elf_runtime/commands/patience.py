"""A word on standard error where a command is silent for long."""

from __future__ import annotations

import sys
import threading
from typing import Any

from .terminal import say

SECONDS = 2.0


class Patience:
    """Says what is being done if two seconds pass before `over`; a context that is over at its end.

    >>> with Patience("elf-detect: big.jpg takes a while ..."):
    ...     pass
    """

    def __init__(self, text: str, quiet: bool = False) -> None:
        self._timer = None if quiet else threading.Timer(SECONDS, say, (text, sys.stderr))
        if self._timer is not None:
            self._timer.daemon = True
            self._timer.start()

    def over(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def __enter__(self) -> Patience:
        return self

    def __exit__(self, *_: Any) -> None:
        self.over()
