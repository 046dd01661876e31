"""What every command begins and ends with: its exit status, and errors for people and for programs."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2

from elf_runtime.errors import ElfError, SettingError, one_line, reason
from elf_runtime.files.write import write_atomically

from .parser import Parser, asks_for_json, print_json_error
from .terminal import discard_stdout, flush_stdout, print_anything, say

FAILED, USAGE, INTERRUPTED, TERMINATED = 1, 2, 128 + signal.SIGINT, 128 + signal.SIGTERM


class UsageError(ElfError):
    """A command line that can't be carried out, whatever the files hold."""


class Terminated(BaseException):
    """SIGTERM came."""


def run(
    parser: Parser,
    work: Callable[[argparse.Namespace], int],
    argv: Sequence[str] | None,
    goes_on: str = "",
) -> int:
    """Parse and work.  An error that a user can cause is one line on standard error, and a status.

    With ``--json`` on standard output it is there too, as `print_json_error` writes it.

    Parameters
    ----------
    goes_on : str
        What to say where the command is interrupted, such as how to go on; by default nothing.

    Returns
    -------
    int
        What `work` returns; 1 where it fails or nobody reads its output any more, 2 on a command line that can't be
        carried out, 130 after Ctrl-C, 143 after SIGTERM.
    """
    closed = sys.stdout is None  # as `>&-` leaves it
    print_anything()
    if "OPENCV_LOG_LEVEL" not in os.environ:
        # What OpenCV logs of a damaged file is said in one line.  Its versions have the function in two places.
        set_level = getattr(getattr(cv2.utils, "logging", cv2), "setLogLevel", None)
        if set_level is not None:
            set_level(0)
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    words = sys.argv[1:] if argv is None else list(argv)
    parser.as_json = asks_for_json(words)
    args = parser.parse_args(words)
    if closed and parser.as_json:
        report(parser.prog, "standard output is closed, and --json writes to it; give it a file")
        return FAILED
    try:
        with terminable():
            status = work(args)
            sys.stdout.flush()
        return status
    except BrokenPipeError:
        discard_stdout()
        return FAILED
    except (ElfError, OSError) as error:
        report(parser.prog, error)
        text, status = text_of(error), USAGE if isinstance(error, (UsageError, SettingError)) else FAILED
    except (KeyboardInterrupt, Terminated) as error:
        text, status = ("terminated", TERMINATED) if isinstance(error, Terminated) else ("interrupted", INTERRUPTED)
        say(f"\n{parser.prog}: {text}{goes_on and f'; {goes_on}'}", sys.stderr)
    if parser.as_json:
        print_json_error(text)
    flush_stdout()
    return status


@contextmanager
def terminable() -> Iterator[None]:
    """Have SIGTERM end what runs as Ctrl-C does: processes that were started are ended, finished work is kept."""

    def end(*_: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # one is enough: what is being cleaned up stays whole
        raise Terminated

    if threading.current_thread() is not threading.main_thread():  # only there can signals be received
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def report(command: str, error: object) -> None:
    """``command: error: ...`` on standard error: one line, or an error's rows below it."""
    say(f"{command}: error: {text_of(error)}", sys.stderr)


def text_of(error: object) -> str:
    """What to say of an error: a line, or several of those that have rows."""
    text = str(error)
    if isinstance(error, OSError):
        text = f"{error.filename}: {reason(error)}" if error.filename else reason(error)
    return text if isinstance(error, ElfError) and error.has_rows else one_line(text)


def write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def write_json(target: str, data: Mapping[str, Any]) -> None:
    """Write data as JSON into a file, whose folder is made, or to standard output where the target is ``-``."""
    text = json.dumps(data, indent=2) + "\n"
    if target == "-":
        sys.stdout.write(text)
    else:
        Path(target).parent.mkdir(parents=True, exist_ok=True)
        write_text(Path(target), text)
