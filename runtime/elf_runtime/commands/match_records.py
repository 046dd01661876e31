"""Feature files of one run: whether their records say the same model and settings."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from elf_runtime.errors import ElfError

from .terminal import say

Record = Mapping[str, Any]


def check_records(records: Mapping[Path, Record], ours: Record, what: str) -> None:
    """Refuse features of another model, and warn of other settings, once for all of them.

    Parameters
    ----------
    records : mapping
        Of each feature file that has one.
    ours : mapping
        What they are held against, which comes from `what`: a model in use, or the first file.

    Raises
    ------
    ElfError
        If one has another model or descriptor.
    """
    others: list[tuple[Path, str]] = []
    for path, record in records.items():
        if any(record.get(name) != ours.get(name) for name in ("model_sha256", "descriptor")):
            raise ElfError(
                f"{path} has descriptors of {_model(record)}, but {what} has those of {_model(ours)}: "
                "they can't be compared"
            )
        if differing := _differing(record, ours):
            others.append((path, differing))
    if others:
        path, differing = others[0]
        warn(f"{path}{and_more(others)}: other settings than {what}: {differing}")


def warn(text: str) -> None:
    """A line on standard error."""
    say(f"elf-match: warning: {text}", sys.stderr)


def and_more(items: Sequence[object]) -> str:
    """What stands behind the first one's name."""
    return f" and {len(items) - 1} more" if len(items) > 1 else ""


def _model(record: Record) -> str:
    return f"{record.get('network')} {record.get('descriptor')} (SHA-256 {str(record.get('model_sha256'))[:12]})"


def _differing(record: Record, ours: Record) -> str:
    """The names of the settings in which two records differ."""
    one, two = (
        json.loads(json.dumps({**(side.get("settings") or {}), "ignore_exif": side.get("ignore_exif")}))
        for side in (record, ours)
    )
    return ", ".join(sorted(name for name in one.keys() | two.keys() if one.get(name) != two.get(name)))
