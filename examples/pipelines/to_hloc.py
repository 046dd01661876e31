"""ELF's keypoints and matches of a folder of images, as hloc's features.h5, matches.h5 and pairs.txt.

python to_hloc.py IMAGES OUT [--ratio R]
"""

import sys
from itertools import combinations

from photos import arguments, features_of, matches_of, photos_in

from elf_runtime.results.hloc import write_features, write_matches

args = arguments(__doc__)
out = args.out
photos = photos_in(args.images)
names = [name.replace("/", "-") for name in photos]  # as hloc writes them in pairs
if twice := [name for name in names if names.count(name) > 1]:
    sys.exit(f"{twice[0]}: hloc writes / as -, which gives two files this name; rename one")
found = features_of(photos)
out.mkdir(parents=True, exist_ok=True)

write_features(out / "features.h5", found)
matches = matches_of(found, args.ratio)
write_matches(out / "matches.h5", (((a, b), (between, len(found[a]))) for (a, b), between in matches))
(out / "pairs.txt").write_text("".join(f"{a} {b}\n" for a, b in combinations(found, 2)), encoding="utf-8")
