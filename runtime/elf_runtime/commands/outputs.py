"""What a command writes: whether it can be written and costs no other file, asked before any work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from elf_runtime.errors import ElfError
from elf_runtime.files.write import existing, real, unwritable

from .command import UsageError


def check_outputs(
    outputs: Mapping[str, Sequence[str | Path | None]],
    inputs: Mapping[str, Sequence[str | Path | None]],
    made: Path | None = None,
) -> None:
    """Refuse outputs that would overwrite an input or one another, or that can't be written.

    Parameters
    ----------
    outputs : mapping
        Option -> its files; None where it is not given, and "-", standard output, are none.
    inputs : mapping
        What they are, in words -> files.
    made : Path, optional
        The folder of ``-o``.  The command makes it, and those above and below it, before it writes.

    Raises
    ------
    UsageError
        If a file is both an output and an input, or an output twice.
    ElfError
        If an output's folder is missing or read-only, or what has an output's name is no file.
    """
    taken = {_identity(path): f"is {what}" for what, files in inputs.items() for path in _paths(files)}
    new = {real(made), *real(made).parents} if made is not None else set()
    if made is not None:
        _check_folder("-o", existing(made))
    for option, files in outputs.items():
        for path in _paths(files):
            identity = _identity(path)
            if identity in taken:
                raise UsageError(f"{option}: {path} {taken[identity]}; give another name or folder")
            taken[identity] = f"is an output of {option}"
            if path.exists() and not path.is_file():
                raise ElfError(f"{option}: {path} exists and is not a file")
        for folder in {path.parent for path in _paths(files)}:
            below = made is not None and real(made) in real(folder).parents
            if below or folder.exists() or real(folder) not in new:
                _check_folder(option, existing(folder) if below else folder)


def _paths(files: Sequence[str | Path | None]) -> list[Path]:
    return [Path(file) for file in files if file is not None and str(file) != "-"]


def _check_folder(option: str, folder: Path) -> None:
    if reason := unwritable(folder):
        raise ElfError(f"{option}: {reason}")


def _identity(path: Path) -> tuple[int, int] | Path:
    """The same for all names of one file: links, and other cases where the file system ignores case."""
    try:
        status = path.stat()
    except OSError:
        return real(path)
    return status.st_dev, status.st_ino
