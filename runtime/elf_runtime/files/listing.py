"""The files of folders; what can't be listed or followed is given too, so that nothing is left out in silence."""

from __future__ import annotations

import glob
import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from elf_runtime.errors import reason


@dataclass
class Listing:
    """What is in a folder.

    Attributes
    ----------
    files : list of Path
        In the order of the file system; links that lead nowhere are among them.
    shut : dict
        Folders that can't be listed -> why: "Permission denied".
    """

    files: list[Path] = field(default_factory=list)
    shut: dict[Path, str] = field(default_factory=dict)


def files_in(folder: Path, recursive: bool, suffixes: Collection[str]) -> Listing:
    """The files of a folder with one of these endings (lower case, with the dot); nothing hidden.

    Parameters
    ----------
    recursive : bool
        Those below its subfolders too, though not through links.
    """
    found, waiting = Listing(), [folder]
    while waiting:
        place = waiting.pop()
        try:
            with os.scandir(place) as entries:
                shown = [entry for entry in entries if not entry.name.startswith(".")]
        except OSError as error:
            found.shut[place] = reason(error)
            continue
        for entry in shown:
            path = place / entry.name
            if _is_folder(entry):
                waiting += [path] if recursive else []
            elif path.suffix.lower() in suffixes and is_file_or_lost(path):
                found.files.append(path)
    return found


def is_file_or_lost(path: Path) -> bool:
    """Whether it is a regular file, or what opening it will say an error of: a link that leads nowhere, for example."""
    try:
        return path.is_file() or not path.exists()
    except OSError:
        return True


def shut_on_the_way(pattern: str) -> Iterator[Path]:
    """The folders that a pattern of `glob` would look into and that can't be listed."""
    head, tail = os.path.split(pattern)
    while tail:
        if glob.has_magic(tail):
            for folder in sorted(glob.glob(head, recursive=True)) if glob.has_magic(head) else [head or os.curdir]:
                if os.path.isdir(folder) and not _can_be_listed(folder):
                    yield Path(folder)
        head, tail = os.path.split(head)


def _can_be_listed(folder: str) -> bool:
    try:
        os.scandir(folder).close()
    except OSError:
        return False
    return True


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir(follow_symlinks=False)
    except OSError:
        return False
