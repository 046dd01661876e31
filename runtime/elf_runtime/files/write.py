"""Folders that can be written into, and files that are whole or absent."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path


def real(path: str | os.PathLike[str]) -> Path:
    """The path with links, ``.`` and ``..`` resolved.  A loop of links ends it, where `Path.resolve` raises."""
    return Path(os.path.realpath(path))


def existing(folder: Path) -> Path:
    """`folder`, or the nearest folder above it that exists."""
    return next(path for path in (folder, *real(folder).parents) if path.exists())


def unwritable(folder: Path) -> str | None:
    """Why no file can be put into `folder`, in words; None where one can."""
    if not folder.exists():
        return f"there is no folder {folder}"
    if not folder.is_dir():
        return f"{folder} is not a folder"
    return None if os.access(folder, os.W_OK | os.X_OK) else f"nothing can be written into the folder {folder}"


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Write to a temporary file beside `path`, then rename it: `path` is whole, or as it was.

    Raises
    ------
    OSError
        If the system refuses, naming `path`; the temporary file is removed.
    """
    # Writers never share a name: neither processes on several machines, nor threads, nor names near the system's limit.
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


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A temporary folder beside `path`, for the block to fill; at its end it takes the name of `path`.

    A folder that is there is deleted then.  Where the block raises, it stays as it was, and nothing is left of the new.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary, old = (path.with_name(f".{path.name[:12]}.{secrets.token_hex(8)}.{what}") for what in ("part", "old"))
    temporary.mkdir()
    try:
        yield temporary
        if path.exists():
            os.replace(path, old)
        os.replace(temporary, path)
    except BaseException:
        if old.exists() and not path.exists():
            os.replace(old, path)
        raise
    finally:
        for folder in (temporary, old):
            shutil.rmtree(folder, ignore_errors=True)
