"""ELF's keypoints and matches of a folder of images, as the text files that COLMAP imports.

python to_colmap.py IMAGES OUT
"""

import sys
from itertools import combinations
from pathlib import Path

import numpy as np

from elf_runtime import ElfRuntime, match
from elf_runtime.image import named, read

images, out = map(Path, sys.argv[1:])
files = [path for path in sorted(images.rglob("*")) if path.suffix.lower() in (".jpg", ".jpeg", ".png")]
photos = {path.relative_to(images).as_posix(): path for path in files}
if not photos:
    sys.exit(f"{images}: no .jpg, .jpeg or .png file in this folder or below it")
if spaced := [name for name in photos if any(map(str.isspace, name))]:
    sys.exit(f"{spaced[0]}: COLMAP's list of matches has no names with spaces; rename the file")

elf = ElfRuntime()
found = {}
for name, path in photos.items():
    pixels = read(path, ignore_exif=True)  # COLMAP's images are as they are stored
    with named(path):
        found[name] = elf.detect(pixels, preset="accurate", max_keypoints=2000)

for name, features in found.items():
    target = out / "features" / f"{name}.txt"
    target.parent.mkdir(parents=True, exist_ok=True)
    count = len(features)
    # COLMAP's first pixel has its centre at (0.5, 0.5).  x, y, scale 1, orientation 0, 128 unused values.
    rows = np.column_stack([features.keypoints + 0.5, np.ones(count), np.zeros((count, 129))])
    np.savetxt(target, rows, fmt=["%.3f"] * 2 + ["%d"] * 130, header=f"{count} 128", comments="")

with open(out / "matches.txt", "w", encoding="utf-8") as file:
    for a, b in combinations(found, 2):
        file.write(f"{a} {b}\n")
        np.savetxt(file, match(found[a], found[b]), fmt="%d")
        file.write("\n")
