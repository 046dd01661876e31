"""Finished pairs, written as they come, so that an interrupted run goes on where it was."""

from __future__ import annotations

import json
from pathlib import Path

from .pair_metrics import Record


class PairLog:
    """Metrics by the key of what they were computed from; on disk one JSON line each.

    Parameters
    ----------
    path : Path, optional
        Lines of an earlier run are read, new ones appended, the first of which makes the folder; None keeps nothing.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.done: dict[str, Record] = {}
        if path is not None and path.exists():
            for line in path.read_text().splitlines():
                self._read(line)

    def _read(self, line: str) -> None:
        try:
            key, values = json.loads(line)
        except ValueError:  # an interruption cut it short
            return
        self.done[key] = values

    def add(self, key: str, values: Record) -> None:
        """Remember and write a pair."""
        self.done[key] = values
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with open(self._path, "a") as file:
                file.write(json.dumps([key, values]) + "\n")
