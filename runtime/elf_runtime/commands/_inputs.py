"""From what stands on a command line to image files, and to a name of its own for each one's output."""

from __future__ import annotations

import glob
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ._common import IMAGE_SUFFIXES, UsageError


def image_files(arguments: Sequence[str], recursive: bool = False) -> list[Path]:
    """Files, the image files of folders (sorted), and what patterns match; each file once.

    Parameters
    ----------
    arguments : sequence of str
    recursive : bool
        Whether a folder's subfolders count, links to folders not; hidden files and folders never do.

    A file that is named stays in the list even if it does not exist: its error belongs to it alone.

    Raises
    ------
    UsageError
        If a folder or a pattern has no image.
    """
    found: list[Path] = []
    for argument in arguments:
        path = Path(argument)
        if path.is_dir():
            entries = path.rglob("*") if recursive else path.iterdir()
            shown = (p for p in entries if not any(part.startswith(".") for part in p.relative_to(path).parts))
            inside = sorted(p for p in shown if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file())
            if not inside:
                place = " or below it" if recursive else "; --recursive looks below it too"
                raise UsageError(
                    f"{argument}: no images ({', '.join(sorted(IMAGE_SUFFIXES))}) in this folder{place}"
                )
            found += inside
        elif not path.exists() and glob.has_magic(argument):
            # Where the shell has not expanded it: it was quoted, or the shell is Windows' own.
            matches = sorted(Path(p) for p in glob.glob(argument, recursive=True))
            if not matches:
                raise UsageError(f"{argument}: no file matches")
            found += [p for p in matches if p.is_file()]
        else:
            found.append(path)
    unique: dict[Path, Path] = {}
    for path in found:
        unique.setdefault(path.resolve(), path)
    return list(unique.values())


def check_pictures(arguments: Sequence[str], paths: Sequence[Path], output: Path, recursive: bool) -> None:
    """Refuse a folder whose pictures would be images of the next run, or are some of this one.

    Parameters
    ----------
    arguments, recursive
        What `image_files` was given.
    paths : sequence of Path
        What it found.
    output : Path
        The folder that gets a NAME.png for each.

    Raises
    ------
    UsageError
        If images are taken from that folder.
    """
    out = output.resolve()
    for folder in map(Path, arguments):
        if folder.is_dir() and (out == folder.resolve() or (recursive and folder.resolve() in out.parents)):
            raise UsageError(
                f"-o {output}: the pictures would be taken for images of the folder {folder} next time; "
                "give a folder outside it, or --no-picture"
            )
    for path in paths:
        if path.suffix.lower() == ".png" and path.parent.resolve() == out:
            raise UsageError(
                f"-o {output}: {path} may be a picture that was written there; give another folder, or --no-picture"
            )


def output_names(paths: Sequence[Path]) -> list[str]:
    """A name for each file's output: its stem, and as much more as tells it from the others.

    ``a/1.png`` and ``b/1.png`` become ``a_1`` and ``b_1``, ``a/x/1.png`` and ``b/x/1.png`` ``a_x_1`` and ``b_x_1``;
    ``1.png`` and ``1.jpg`` of one folder become ``1_png`` and ``1_jpg``.  Names that differ in case only count as
    equal, as some file systems have it.
    """
    folders = [path.parent.relative_to(path.anchor).parts for path in map(Path.resolve, paths)]
    depths = range(max(map(len, folders), default=0) + 1)
    tiers = [(depth, suffix) for suffix in (False, True) for depth in depths]
    names: dict[int, str] = {}
    for depth, suffix in tiers:
        rest = {
            i: "_".join([*folders[i][len(folders[i]) - depth :], path.stem, *([path.suffix[1:]] if suffix else [])])
            for i, path in enumerate(paths)
            if i not in names and depth <= len(folders[i])
        }
        counts = Counter(name.lower() for name in (*rest.values(), *names.values()))
        names |= {i: name for i, name in rest.items() if counts[name.lower()] == 1}
    taken = {name.lower() for name in names.values()}
    for i, path in enumerate(paths):
        number = 2
        while i not in names:
            name = f"{path.stem}_{number}"
            if name.lower() not in taken:
                names[i] = name
                taken.add(name.lower())
            number += 1
    return [names[i] for i in range(len(paths))]
