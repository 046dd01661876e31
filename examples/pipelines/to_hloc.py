"""ELF's keypoints and matches of a folder of images, as hloc's features.h5, matches.h5 and pairs.txt.

python to_hloc.py IMAGES OUT
"""

import sys
from itertools import combinations
from pathlib import Path

import h5py
import numpy as np

from elf_runtime import ElfRuntime, match
from elf_runtime.image import named, read

images, out = map(Path, sys.argv[1:])
files = [path for path in sorted(images.rglob("*")) if path.suffix.lower() in (".jpg", ".jpeg", ".png")]
photos = {path.relative_to(images).as_posix(): path for path in files}
if not photos:
    sys.exit(f"{images}: no .jpg, .jpeg or .png file in this folder or below it")
if spaced := [name for name in photos if any(map(str.isspace, name))]:
    sys.exit(f"{spaced[0]}: hloc's list of pairs has no names with spaces; rename the file")
names = [name.replace("/", "-") for name in photos]  # as hloc writes them in pairs
if twice := [name for name in names if names.count(name) > 1]:
    sys.exit(f"{twice[0]}: hloc writes / as -, which gives two files this name; rename one")

elf = ElfRuntime()
found = {}
for name, path in photos.items():
    pixels = read(path, ignore_exif=True)  # the cameras that COLMAP estimates are of the stored pixels
    with named(path):
        found[name] = elf.detect(pixels, preset="accurate", max_keypoints=2000)
out.mkdir(parents=True, exist_ok=True)

with h5py.File(out / "features.h5", "w") as file:
    for name, features in found.items():
        group = file.create_group(name)
        group["keypoints"] = features.keypoints  # hloc adds COLMAP's half pixel itself
        group["scores"] = features.scores
        group["descriptors"] = features.descriptors.T  # (D, N)
        group["image_size"] = features.image_size[::-1]  # (width, height)

with h5py.File(out / "matches.h5", "w") as file, open(out / "pairs.txt", "w", encoding="utf-8") as list_:
    for a, b in combinations(found, 2):
        list_.write(f"{a} {b}\n")
        first, second = match(found[a], found[b]).T
        partners = np.full(len(found[a]), -1, np.int32)  # of each keypoint of a, in b; -1 is none
        cosines = np.zeros(len(found[a]), np.float32)
        partners[first] = second
        cosines[first] = (found[a].descriptors[first] * found[b].descriptors[second]).sum(axis=1)
        group = file.create_group("/".join(name.replace("/", "-") for name in (a, b)))
        group["matches0"], group["matching_scores0"] = partners, cosines
