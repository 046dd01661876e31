"""Standard output and error, whatever reads them: a terminal, a pipe, or nobody any more."""

from __future__ import annotations

import io
import os
import sys
from typing import TextIO

from elf_runtime.errors import printable


def print_anything() -> None:
    """Have standard output and error take any text: what they can't encode is written as ``\\udcff`` or the like.

    File names may be no Unicode, and a terminal, or what a scheduler runs a command with, may know ASCII only.  What
    would go to one that is closed goes nowhere.
    """
    # Where one is closed (>&-), Python has None for it, and its number may be given to a file next.
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 (it stays open)
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def flush_stdout() -> None:
    """Write what is still to be written, if that can be done: the reason why not has been said."""
    try:
        sys.stdout.flush()
    except OSError:
        discard_stdout()


def discard_stdout() -> None:
    """Send what is still to be flushed nowhere: for a command whose reader, `head` for example, has seen enough."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def say(text: str, stream: TextIO | None = None) -> None:
    """Print lines, by default to standard output, without anything that a terminal would obey."""
    print("\n".join(map(printable, text.split("\n"))), file=stream or sys.stdout)
