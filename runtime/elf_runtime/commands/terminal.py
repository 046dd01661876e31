"""Standard output and error, whatever reads them: a terminal, a pipe, or nobody any more."""

from __future__ import annotations

import io
import os
import sys
from typing import TextIO

from elf_runtime.errors import printable


def print_anything() -> None:
    """Have standard output and error take any text: what they can't encode is written as ``\\udcff`` or the like.

    File names may be no Unicode, and a terminal, or what a scheduler runs a command with, may know ASCII only.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def discard_stdout() -> None:
    """Send what is still to be flushed nowhere: for a command whose reader, `head` for example, has seen enough."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def say(text: str, stream: TextIO | None = None) -> None:
    """Print lines, by default to standard output, without anything that a terminal would obey."""
    print("\n".join(map(printable, text.split("\n"))), file=stream or sys.stdout)
