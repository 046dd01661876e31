"""What both scripts begin with: the photographs of a folder, and ELF's features of each."""

import sys
from pathlib import Path

from elf_runtime import ElfRuntime, Features
from elf_runtime.image import named, read


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
        with named(path):
            found[name] = elf.detect(pixels, preset="accurate", max_keypoints=2000)
    return found
