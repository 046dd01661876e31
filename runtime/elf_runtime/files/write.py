"""Files that are whole or absent, and standard output whose reader has gone."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import secrets
import sys
from collections.abc import Callable
from pathlib import Path

from .kind import open_regular


def print_anything() -> None:
    """Let standard output and error take any text: what they can't encode is written as ``\\udcff`` or the like.

    File names may be no Unicode, and a terminal, or what a scheduler runs a command with, may know ASCII only.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def discard_stdout() -> None:
    """Let what is still to be flushed go nowhere: for a command whose reader, `head` for example, has seen enough."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def real(path: str | os.PathLike[str]) -> Path:
    """The path without links, ``.`` and ``..``; as far as it goes into a loop of links, where `Path.resolve` raises."""
    return Path(os.path.realpath(path))


def existing(folder: Path) -> Path:
    """`folder`, or the nearest above it that is there: where one that is to be made begins."""
    return next(path for path in (folder, *real(folder).parents) if path.exists())


def unwritable(folder: Path) -> str | None:
    """Why no file can be put into `folder`, in words; None where one can."""
    if not folder.exists():
        return f"there is no folder {folder}"
    if not folder.is_dir():
        return f"{folder} is not a folder"
    return None if os.access(folder, os.W_OK | os.X_OK) else f"nothing can be written into the folder {folder}"


def file_sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file, read in pieces."""
    found = hashlib.sha256()
    with open_regular(path) as file:
        while piece := file.read(1 << 20):
            found.update(piece)
    return found.hexdigest()


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a neighbour of `path`, then put it in place: `path` is whole or as it was.

    Raises
    ------
    OSError
        If the system refuses, naming `path` and not the neighbour, of which nothing is left.
    """
    # A name of its own for every writer: processes on several machines, threads, and names near the system's limit.
    temporary = path.with_name(f".{path.stem[:12]}.{secrets.token_hex(8)}.part{path.suffix}")
    try:
        write(temporary)
        os.replace(temporary, path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError) and error.errno is not None:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
