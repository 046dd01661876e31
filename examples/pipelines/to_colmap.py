"""ELF's keypoints and matches of a folder of images, as the text files that COLMAP imports.

python to_colmap.py IMAGES OUT [--ratio R]
"""

from photos import arguments, features_of, matches_of, photos_in

from elf_runtime.results.colmap import write_colmap_matches, write_colmap_text

args = arguments(__doc__)
found = features_of(photos_in(args.images))

for name, features in found.items():
    target = args.out / "features" / f"{name}.txt"
    target.parent.mkdir(parents=True, exist_ok=True)
    write_colmap_text(target, features)

write_colmap_matches(args.out / "matches.txt", matches_of(found, args.ratio))
