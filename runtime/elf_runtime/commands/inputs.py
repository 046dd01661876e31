"""The image files that a command line names, and for each a name of its own for its results."""

from __future__ import annotations

import glob
import os
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from elf_runtime.extraction.store import SHARD
from elf_runtime.files.listing import Listing, files_in, is_file_or_lost, shut_on_the_way
from elf_runtime.files.write import real
from elf_runtime.image.video import VIDEO_SUFFIXES
from elf_runtime.results.features import load_record

from .command import UsageError

# What `cv2.imread` of every build decodes; a folder may hold other files too.
IMAGE_SUFFIXES = frozenset(
    (".bmp", ".jpeg", ".jpg", ".jp2", ".pbm", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp")
)
# What some builds of OpenCV decode too; such files are taken where they are named.
_OTHER_SUFFIXES = frozenset((".avif", ".exr", ".gif", ".hdr", ".jpe", ".pam", ".pfm", ".pic", ".ras", ".sr"))


def image_files(arguments: Sequence[str], recursive: bool = False, base: Path | None = None) -> dict[Path, Path]:
    """The files that are named, the image files of folders (sorted), and what patterns match; each file once.

    Parameters
    ----------
    arguments : sequence of str
    recursive : bool
        Whether to look into the subfolders of folders, though not through links.  Hidden files and folders never count,
        nor do pictures that elf-detect wrote.
    base : Path, optional
        See below.

    A file that is named stays in the list even if it does not exist, so that its error stops no other; so do links that
    lead nowhere, and folders that can't be listed, whose opening says why.

    Returns
    -------
    dict
        Each image's path -> the name, without ending, of what is written for it, whatever else is in the run: its path
        as it is given, ``photos/x/1`` for ``../photos/x/1.jpg``; of an absolute one the part below the folder that is
        given, or the file's name; with `base`, the part below that.  The ending stays where the folder has an image
        that differs in nothing else.

    Raises
    ------
    UsageError
        If a folder or a pattern has no image, or an image is not below `base`.
    """
    found: list[tuple[Path, Path]] = []
    for argument in arguments:
        path = Path(argument)
        if os.path.isdir(path):  # where Path.is_dir raises, the image has an error of its own
            images = images_in(path, recursive)
            inside = sorted([*images.files, *images.shut])
            if not inside:
                raise UsageError(f"{argument}: {_why_none(path, recursive)}")
            found += [(p, path) for p in inside]
        elif not os.path.lexists(path) and glob.has_magic(argument):
            # The shell has not expanded it: it was quoted, or the shell is Windows' own.
            matches = [p for p in map(Path, glob.glob(argument, recursive=True)) if is_file_or_lost(p)]
            matches += shut_on_the_way(argument)
            if not matches:
                raise UsageError(f"{argument}: no file matches")
            found += [(p, p.parent) for p in sorted(matches)]
        else:
            found.append((path, path.parent))
    names: dict[Path, Path] = {}
    seen: set[str] = set()
    for path, folder in found:
        if os.path.abspath(path) not in seen:
            seen.add(os.path.abspath(path))
            names[path] = _name(path, folder, base)
    return names


def _why_none(folder: Path, recursive: bool) -> str:
    """What to say of a folder that can be listed and has no images."""
    if any(SHARD.fullmatch(name) for name in os.listdir(folder)):
        return (
            "no images in this folder, but shards of elf-detect --engine ray: in Python, "
            "elf_runtime.extraction.shards.read_shards gives their features, and save(FILE) makes an .npz of each"
        )
    place = " or below it" if recursive else "; --recursive looks below it too"
    return f"no images ({', '.join(sorted(IMAGE_SUFFIXES))}) in this folder{place}"


def images_in(folder: Path, recursive: bool) -> Listing:
    """The image files of a folder, but for pictures that elf-detect wrote."""
    found = files_in(folder, recursive, IMAGE_SUFFIXES)
    return Listing([path for path in found.files if not is_written(path)], found.shut)


def video_files(arguments: Sequence[str], base: Path | None = None) -> dict[Path, Path]:
    """The video files that are named or match a pattern -> the folder of their frames' results, as `image_files`.

    Raises
    ------
    UsageError
        If a pattern matches no file, or a file is not below `base`.
    """
    names: dict[Path, Path] = {}
    for argument in arguments:
        matches = [Path(argument)]
        if not os.path.lexists(argument) and glob.has_magic(argument):
            matches = sorted([*map(Path, glob.glob(argument, recursive=True)), *shut_on_the_way(argument)])
            if not matches:
                raise UsageError(f"{argument}: no file matches")
        for path in matches:
            names[path] = _name(path, path.parent, base)
    return names


def _name(path: Path, folder: Path, base: Path | None) -> Path:
    if base is not None:
        whole, start = Path(os.path.abspath(path)), os.path.abspath(base)
        if not whole.is_relative_to(start):
            raise UsageError(f"--base {base}: {path} is not below it")
        return _without_ending(whole.relative_to(start), path)
    below = path.relative_to(folder) if path.is_absolute() else path
    return _without_ending(Path(*(part for part in below.parts if part != "..")), path)


def _without_ending(name: Path, path: Path) -> Path:
    """`name` without its ending, unless another image of its folder would have that name too."""
    try:
        kind = VIDEO_SUFFIXES if path.suffix.lower() in VIDEO_SUFFIXES else IMAGE_SUFFIXES | _OTHER_SUFFIXES
        stems = _stems(path.parent, os.stat(path.parent).st_mtime_ns, kind)
    except OSError:  # the image has an error of its own
        return name.with_suffix("")
    return name if _keeps_ending(path, stems) else name.with_suffix("")


def _keeps_ending(path: Path, stems: Counter[str]) -> bool:
    """Whether another image differs in its ending only, or keeps its own and is called as this one is without."""
    other = path.with_suffix("")
    return stems[path.stem] > 1 or (bool(other.suffix) and os.path.isfile(other) and _keeps_ending(other, stems))


def settled(path: Path, name: Path, output: Path) -> Path:
    """The name of an image's results in a folder where it may have some already: these keep theirs.

    Whether `name`, of `image_files`, has an ending depends on the images beside it, and these may come and go.
    """
    short, long = name.with_name(name.name.removesuffix(path.suffix)), _with_ending(name, path)
    real_path = os.path.realpath(path)

    def owner_of(stem: Path) -> object:
        return (load_record(Path(f"{output / stem}.npz")) or {}).get("image")

    owner = owner_of(short)
    if owner == real_path:  # most often: the other file is not opened then
        return short
    if owner_of(long) == real_path:
        return long
    beside = isinstance(owner, str) and os.path.dirname(owner) == os.path.dirname(real_path)
    return long if beside else name


def _with_ending(name: Path, path: Path) -> Path:
    return name if name.name == path.name else name.with_name(name.name + path.suffix)


@lru_cache(maxsize=1024)
def _stems(folder: Path, _: int, suffixes: frozenset[str]) -> Counter[str]:
    """How many images, or videos, of a folder have a name; a picture that elf-detect wrote is none."""
    images = [path for path in folder.iterdir() if path.suffix.lower() in suffixes]
    counts = Counter(path.stem for path in images)
    counts.subtract(path.stem for path in images if counts[path.stem] > 1 and is_written(path))
    return counts


def is_written(path: Path) -> bool:
    """Whether an image is a picture that elf-detect wrote of another one."""
    if path.suffix.lower() != ".png":
        return False
    stem = path.name.removesuffix(".png").removesuffix(".explain")
    records = [load_record(file) for file in {path.with_suffix(".npz"), path.with_name(f"{stem}.npz")}]
    return any(record is not None and record.get("image") != os.path.realpath(path) for record in records)


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
    out = real(output)
    for folder in map(Path, arguments):
        if os.path.isdir(folder) and (out == real(folder) or (recursive and real(folder) in out.parents)):
            raise UsageError(
                f"-o {output}: the pictures would be taken for images of the folder {folder} next time; "
                "give a folder outside it, or write no pictures (--no-picture, and no --explain)"
            )
    for path in paths:
        if is_written(path):
            raise UsageError(f"{path} is a picture that elf-detect wrote; leave it out, or --picture and --explain")
