"""What both scripts share: the command line, the photographs of a folder, ELF's features of each, and their matches."""

import argparse
import sys
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

from elf_runtime import ElfRuntime, Features, Matches
from elf_runtime.image.file import image_errors, read

RATIO = 0.9  # repeated texture has second neighbours that are nearly as near: no match is better than a wrong one


def arguments(description: str | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=Path, metavar="IMAGES", help="folder of the photographs")
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of what is written")
    parser.add_argument(
        "--ratio", type=_ratio, default=RATIO, metavar="R",
        help=f"keep a match only where its distance is below R times that of the next best ({RATIO}); 'none': keep all",
    )  # fmt: skip
    return parser.parse_args()


def _ratio(text: str) -> float | None:
    if text == "none":
        return None
    value = float(text)
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 1, nor 'none'")
    return value


def photos_in(folder: Path) -> dict[str, Path]:
    """Name, relative to the folder -> file."""
    files = [path for path in sorted(folder.rglob("*")) if path.suffix.lower() in (".jpg", ".jpeg", ".png")]
    if not files:
        sys.exit(f"{folder}: no .jpg, .jpeg or .png file in this folder or below it")
    photos = {path.relative_to(folder).as_posix(): path for path in files}
    if spaced := [name for name in photos if any(map(str.isspace, name))]:
        sys.exit(f"{spaced[0]}: COLMAP's and hloc's lists have no names with spaces; rename the file")
    return photos


def features_of(photos: dict[str, Path]) -> dict[str, Features]:
    elf = ElfRuntime()
    found = {}
    for name, path in photos.items():
        pixels = read(path, ignore_exif=True)  # the cameras that COLMAP estimates are of the stored pixels
        with image_errors(path):
            found[name] = elf.detect(pixels, preset="accurate", max_keypoints=2000)
    return found


def matches_of(found: dict[str, Features], ratio: float | None) -> Iterator[tuple[tuple[str, str], Matches]]:
    """Of every image with every later one: both names, and what matches."""
    for a, b in combinations(found, 2):
        yield (a, b), Matches.between(found[a], found[b], ratio=ratio)
