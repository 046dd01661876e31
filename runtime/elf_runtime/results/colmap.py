"""Keypoints and matches as the text files that COLMAP imports: ``feature_importer`` and ``matches_importer``.

COLMAP's cameras are of the pixels as a file stores them: detect in `image.read` with ``ignore_exif=True``.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from elf_runtime.errors import ElfError
from elf_runtime.files.write import write_atomically
from elf_runtime.indices import pairs_of

from .features import Features

_UNUSED = 128  # values of SIFT's descriptor, which the format wants


def write_colmap_text(path: str | os.PathLike[str], features: Features) -> None:
    """Write one image's keypoints, for COLMAP's ``feature_importer``, which looks for ``IMAGE.txt``.

    The first line is ``N 128``.  Then for each keypoint: x and y, whose first pixel has its centre at (0.5, 0.5); its
    size, 1 for the smallest; its orientation in radians, 0 for none; and 128 zeros in place of SIFT's descriptor, since
    ELF's are others.  So COLMAP can't match them: import the matches, too.

    Raises
    ------
    OSError
        If the file can't be written; what was there stays.
    """
    scale = features.sizes / features.sizes.min(initial=np.inf)
    angle = np.radians(np.maximum(features.angles, 0))
    rows = np.column_stack([features.keypoints + 0.5, scale, angle, np.zeros((len(features), _UNUSED))])
    form = ["%.3f"] * 4 + ["%d"] * _UNUSED
    header = f"{len(features)} {_UNUSED}"
    write_atomically(Path(path), lambda part: np.savetxt(part, rows, fmt=form, header=header, comments=""))


def write_colmap_matches(
    path: str | os.PathLike[str],
    matches: Mapping[tuple[str, str], Any] | Iterable[tuple[tuple[str, str], Any]],
) -> None:
    """Write the matches of pairs of images, for COLMAP's ``matches_importer`` with ``--match_type raw``.

    Parameters
    ----------
    path : path
    matches : mapping, or iterable of its items
        (name, name) of two images, as COLMAP has them -> `Matches`, or (K, 2) integers as of `match`.  They are written
        in the order of their indices.  Of an iterable only one pair of images is in memory at a time.

    Raises
    ------
    ElfError
        If a name has spaces, which separate names there; SettingError if matches are neither.
    OSError
        If the file can't be written; what was there stays.
    """
    items = matches.items() if isinstance(matches, Mapping) else matches

    def write(part: Path) -> None:
        with part.open("w", encoding="utf-8") as file:
            for names, given in items:
                if spaced := [name for name in names if any(map(str.isspace, name))]:
                    raise ElfError(f"{spaced[0]}: COLMAP's lists have no names with spaces")
                file.write(" ".join(names) + "\n")
                file.writelines(f"{i} {j}\n" for i, j in sorted(pairs_of(given).tolist()))
                file.write("\n")

    write_atomically(Path(path), write)
