"""ELF's keypoints and matches of a folder of images, as hloc's features.h5, matches.h5 and pairs.txt.

python to_hloc.py IMAGES OUT [--ratio R]
"""

import sys

import h5py
import numpy as np
from photos import arguments, features_of, matches_of, photos_in

args = arguments(__doc__)
out = args.out
photos = photos_in(args.images)
names = [name.replace("/", "-") for name in photos]  # as hloc writes them in pairs
if twice := [name for name in names if names.count(name) > 1]:
    sys.exit(f"{twice[0]}: hloc writes / as -, which gives two files this name; rename one")
found = features_of(photos)
out.mkdir(parents=True, exist_ok=True)

with h5py.File(out / "features.h5", "w") as file:
    for name, features in found.items():
        group = file.create_group(name)
        group["keypoints"] = features.keypoints  # hloc adds COLMAP's half pixel itself
        group["scores"] = features.scores
        group["sizes"], group["angles"] = features.sizes, features.angles
        group["descriptors"] = features.descriptors.T  # (D, N)
        group["image_size"] = features.image_size[::-1]  # (width, height)

with h5py.File(out / "matches.h5", "w") as file, open(out / "pairs.txt", "w", encoding="utf-8") as list_:
    for a, b, pairs in matches_of(found, args.ratio):
        list_.write(f"{a} {b}\n")
        first, second = pairs.T
        partners = np.full(len(found[a]), -1, np.int32)  # of each keypoint of a, in b; -1 is none
        cosines = np.zeros(len(found[a]), np.float32)
        partners[first] = second
        cosines[first] = (found[a].descriptors[first] * found[b].descriptors[second]).sum(axis=1)
        group = file.create_group("/".join(name.replace("/", "-") for name in (a, b)))
        group["matches0"], group["matching_scores0"] = partners, cosines
