"""Which images elf-match takes, and which of them it pairs."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

from elf_runtime.errors import ElfError, reason, suggestion
from elf_runtime.files.kind import open_regular
from elf_runtime.files.listing import Listing, files_in

from .command import UsageError
from .inputs import image_files, images_in, is_written

FEATURE_SUFFIX = ".npz"
Pairs = list[tuple[int, int]]


@dataclass(frozen=True)
class Choice:
    """What --pairs says.

    Attributes
    ----------
    kind : "exhaustive", "sequential", "nearest" or "file"
    count : int
        Of those that follow, or of the nearest.
    file : Path, optional
    """

    kind: str = "exhaustive"
    count: int = 1
    file: Path | None = None

    @classmethod
    def of(cls, text: str) -> Choice:
        """Of the option's text.

        Raises
        ------
        UsageError
            If it is none of these, and no file.
        """
        found = re.fullmatch(r"(exhaustive)|(sequential|nearest):0*([1-9]\d{0,8})|(sequential)", text)
        if found is not None:
            return cls(found[1] or found[2] or found[4], int(found[3] or 1))
        if not os.path.lexists(text):
            kind, kinds = text.partition(":")[0], ("exhaustive", "sequential", "nearest")
            raise UsageError(
                f"--pairs {text}: not exhaustive, sequential, sequential:N or nearest:N with N from 1 on, and no file "
                f"of this name{'' if kind in kinds else suggestion(kind, kinds)}"
            )
        return cls("file", file=Path(text))


@dataclass(frozen=True)
class Plan:
    """The images or feature files, and their pairs.

    Attributes
    ----------
    paths : list of Path
        Each one once.
    names : list of str
        Of what is printed and written for them: the path below the folder.
    pairs : list of (int, int), optional
        Into these; None where they are to be chosen by global descriptors.
    nearest : int
        How many are then chosen for each image.
    single : bool
        Whether two images were given, not a folder.
    query : bool
        Whether the first one is held against the others, and these not against each other.
    shut : mapping
        Folders below the folder that can't be listed -> why.
    """

    paths: list[Path]
    names: list[str]
    pairs: Pairs | None
    nearest: int = 0
    single: bool = False
    query: bool = False
    shut: Mapping[Path, str] = field(default_factory=dict)


def plan(first: str, second: str | None, choice: Choice | None, recursive: bool) -> Plan:
    """What the command line asks for.

    Raises
    ------
    UsageError
        If there is nothing to pair, an option does not go with what is given, or a list of pairs has what is not
        there.
    ElfError
        If there is nothing to pair because folders can't be listed.
    """
    a = Path(first)
    if second is None:
        if not a.is_dir():
            raise UsageError(f"{first}: give a second image or a folder, or a folder alone")
        return _of_folder(a, choice or Choice(), recursive)
    if a.is_dir():
        raise UsageError(f"{first} is a folder: give it alone, or as the second one, to hold an image against it")
    if Path(second).is_dir():
        return _against_folder(a, Path(second), choice or Choice(), recursive)
    if choice is not None or recursive:
        raise UsageError(f"{'--pairs' if choice else '--recursive'} goes with a folder, not with two images")
    return Plan([a, Path(second)], [first, second], [(0, 1)], single=True)


def _of_folder(folder: Path, choice: Choice, recursive: bool) -> Plan:
    if choice.file is not None:
        listed = read_list(choice.file, folder)
        paths = list(dict.fromkeys(path for pair in listed for path in pair))
        place = {path: index for index, path in enumerate(paths)}
        return Plan(paths, _names(paths, folder), [(place[one], place[two]) for one, two in listed])
    found = members(folder, recursive)
    paths, shut = found.files, found.shut
    if len(paths) < 2:
        _refuse_shut(shut)
        raise UsageError(f"{folder}: there is one image in this folder, {paths[0].name}, and nothing to match it with")
    names = _names(paths, folder)
    if choice.kind == "nearest":
        return Plan(paths, names, None, choice.count, shut=shut)
    reach = choice.count if choice.kind == "sequential" else len(paths)
    return Plan(paths, names, [(i, j) for i, j in combinations(range(len(paths)), 2) if j - i <= reach], shut=shut)


def _against_folder(image: Path, folder: Path, choice: Choice, recursive: bool) -> Plan:
    if choice.kind not in ("exhaustive", "nearest"):
        raise UsageError("one image against a folder takes --pairs nearest:N or none")
    own = os.path.realpath(image)
    found = members(folder, recursive)
    others = [path for path in found.files if os.path.realpath(path) != own]
    if not others:
        _refuse_shut(found.shut)
        raise UsageError(f"{folder}: there is no other image in this folder than {image}")
    paths, names = [image, *others], [image.name, *_names(others, folder)]
    if choice.kind == "nearest":
        return Plan(paths, names, None, choice.count, query=True, shut=found.shut)
    return Plan(paths, names, [(0, j) for j in range(1, len(paths))], query=True, shut=found.shut)


def _refuse_shut(shut: Mapping[Path, str]) -> None:
    for folder, why in shut.items():
        raise ElfError(f"{folder}: {why}")


def members(folder: Path, recursive: bool) -> Listing:
    """The image files of a folder, as `image_files`, or the feature files of one without images, in natural order.

    Raises
    ------
    UsageError
        If it has neither, though all of it can be listed.
    """
    found = images_in(folder, recursive)
    if not found.files:
        results = files_in(folder, recursive, (FEATURE_SUFFIX,))
        found = results if results.files else found
    if not found.files and not found.shut:
        image_files([str(folder)], recursive)  # says what is missing
    return Listing(sorted(found.files, key=natural), found.shut)


def natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Sorts 2.jpg before 10.jpg."""
    parts = re.split(r"(\d+)", str(path))
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts], str(path)


def _names(paths: Sequence[Path], folder: Path) -> list[str]:
    return [path.relative_to(folder).as_posix() for path in paths]


def file_stem(one: str, two: str) -> str:
    """What the files of a pair are called, no two pairs the same: ``a%2F1.jpg--b%2F1.jpg`` for a/1.jpg and b/1.jpg.

    In a name, / is %2F, % is %25, and the second of two hyphens, which would be taken for the middle, is %2D.
    """
    # No name ends in a hyphen, for it has an ending: the first two in a row are the middle.
    first, second = (re.sub("(?<=-)-", "%2D", name.replace("%", "%25").replace("/", "%2F")) for name in (one, two))
    return f"{first}--{second}"


def read_list(file: Path, folder: Path) -> list[tuple[Path, Path]]:
    """The pairs of a text file: two names a line, of files below the folder, each pair once.

    White space is between them, or a tab where names have spaces; # begins a comment.  A name may be that of an image
    whose feature file is there.

    Raises
    ------
    UsageError
        On a file that can't be read, a line of another form, a name that is not there, or no pair at all.
    """
    try:
        with open_regular(file) as opened:
            lines = opened.read().decode("utf-8-sig", "surrogateescape").splitlines()
    except OSError as error:
        raise UsageError(f"--pairs {file}: {reason(error)}") from error
    found: dict[frozenset[Path], tuple[Path, Path]] = {}
    for number, line in enumerate(lines, 1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        names = [name.strip() for name in text.split("\t")] if "\t" in text else text.split()
        where = f"--pairs {file}, line {number}"
        if len(names) != 2:
            raise UsageError(f"{where}: two names are expected, with a tab between them if they have spaces")
        one, two = (_listed(name, folder, where) for name in names)
        if one == two:
            raise UsageError(f"{where}: {names[0]} is paired with itself")
        found.setdefault(frozenset((one, two)), (one, two))
    if not found:
        raise UsageError(f"--pairs {file}: there are no pairs in this file")
    return list(found.values())


def _listed(name: str, folder: Path, where: str) -> Path:
    path = Path(os.path.normpath(folder / name))
    if not path.is_relative_to(os.path.normpath(folder)):
        raise UsageError(f"{where}: {name} is not below the folder {folder}")
    # elf-detect writes the features of photos/1.jpg to photos/1.npz, or to photos/1.jpg.npz.
    for candidate in (path, path.with_suffix(FEATURE_SUFFIX), Path(f"{path}{FEATURE_SUFFIX}")):
        if candidate.is_file() and not is_written(candidate):
            return folder / candidate.relative_to(os.path.normpath(folder))
    raise UsageError(f"{where}: there is no {name} in the folder {folder}")
