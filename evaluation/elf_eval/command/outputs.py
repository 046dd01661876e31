"""The folder that a command writes into: checked before the work, named after it."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from elf_eval.errors import EvalError
from elf_runtime.files.write import existing, unwritable


def check_folder(folder: Path) -> None:
    """Refuse a path that is not a folder or can't be written into.  A missing folder is not made yet."""
    if reason := unwritable(existing(folder)):
        raise EvalError(reason)


def say_written(folder: Path, names: Iterable[str]) -> None:
    """Name on stderr what was written."""
    print(f"written: {folder}/{', '.join(names)}", file=sys.stderr)
