"""Finished pairs, written as they come, so that an interrupted run can go on from there."""

from __future__ import annotations

import json
import sys
import zlib
from pathlib import Path

from elf_eval.metrics.family import Record


class PairLog:
    """Metrics by the key of what they were computed from; on disk a JSON line each, with its checksum.

    Parameters
    ----------
    path : Path, optional
        The lines of an earlier run are read, and new ones appended; the first one makes the folder.  Damaged lines are
        reported once and dropped, and their pairs are evaluated again.  None keeps nothing.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.done: dict[str, Record] = {}
        if path is None or not path.exists():
            return
        lines = path.read_bytes().splitlines()
        damaged = sum(not self._read(line) for line in lines)
        if damaged:
            print(
                f"elf-eval: {path}: {damaged} of {len(lines)} lines are damaged; their pairs are evaluated again",
                file=sys.stderr,
            )
            path.write_text("".join(map(_line, self.done.items())), encoding="utf-8")

    def _read(self, line: bytes) -> bool:
        try:
            check, key, values = json.loads(line)
            whole = bool(check == _checksum(key, values)) and isinstance(key, str)
        except (ValueError, TypeError, RecursionError):
            return False
        if whole:
            self.done[key] = values
        return whole

    def add(self, key: str, values: Record) -> None:
        """Remember and write a pair."""
        self.done[key] = values
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with open(self._path, "a", encoding="utf-8") as file:
                file.write(_line((key, values)))


def _line(pair: tuple[str, Record]) -> str:
    return json.dumps([_checksum(*pair), *pair]) + "\n"


def _checksum(key: str, values: Record) -> int:
    return zlib.crc32(json.dumps([key, values]).encode())
