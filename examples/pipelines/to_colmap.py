"""ELF's keypoints and matches of a folder of images, as the text files that COLMAP imports.

python to_colmap.py IMAGES OUT [--ratio R]
"""

import numpy as np
from photos import arguments, features_of, matches_of, photos_in

args = arguments(__doc__)
found = features_of(photos_in(args.images))

for name, features in found.items():
    target = args.out / "features" / f"{name}.txt"
    target.parent.mkdir(parents=True, exist_ok=True)
    count = len(features)
    # COLMAP's first pixel has its centre at (0.5, 0.5).  x, y, scale (1 for the smallest size), orientation in radians
    # (0 for none), 128 unused values.
    scale = features.sizes / features.sizes.min(initial=np.inf)
    angle = np.radians(np.maximum(features.angles, 0))
    rows = np.column_stack([features.keypoints + 0.5, scale, angle, np.zeros((count, 128))])
    np.savetxt(target, rows, fmt=["%.3f"] * 4 + ["%d"] * 128, header=f"{count} 128", comments="")

with open(args.out / "matches.txt", "w", encoding="utf-8") as file:
    for a, b, pairs in matches_of(found, args.ratio):
        file.write(f"{a} {b}\n")
        np.savetxt(file, pairs, fmt="%d")
        file.write("\n")
