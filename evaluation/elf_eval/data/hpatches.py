"""HPatches' sequences, and whatever has their layout: ``i_*`` illumination, ``v_*`` viewpoint.

root/v_boat/1.ppm ... 6.ppm, H_1_2 ... H_1_6        H_1_k: pixels of image 1 -> pixels of image k
"""

from __future__ import annotations

import re
from pathlib import Path

from elf_eval.errors import EvalError
from elf_eval.spec import Spec, boolean, comma_separated

from .dataset import Dataset, Pair
from .files import folders_in, only_image, read_homography
from .images import ImageRef

# Left out of the evaluation of D2-Net, and of most since, for their large images.
USUALLY_DROPPED = frozenset(
    [
        "i_contruction",
        "i_crownnight",
        "i_dc",
        "i_pencils",
        "i_whitebuilding",
        "v_artisans",
        "v_astronautis",
        "v_talent",
    ]
)


def hpatches(spec: Spec) -> Dataset:
    """``hpatches:FOLDER``; options ``part=i`` or ``v``, ``scenes=a,b``, ``drop8=true``."""
    part = spec.take("part", str, "")
    wanted = comma_separated(spec.take("scenes", str, ""))
    drop = spec.take("drop8", boolean, False)
    pairs: list[Pair] = []
    for folder in scene_folders(spec, part, wanted):
        if not (drop and folder.name in USUALLY_DROPPED):
            with spec.whole(folder.name):
                pairs += scene_pairs(folder)
    if not pairs:
        raise EvalError(f"{spec.text}: no pairs are left")
    return Dataset("hpatches", tuple(pairs))


def scene_folders(spec: Spec, part: str, wanted: list[str]) -> list[Path]:
    """The scene folders that the options leave, in natural order."""
    if part not in ("", "i", "v"):
        raise EvalError(f"{spec.text}: option part={part}: expected i or v")
    root = spec.folder()
    scenes = [f for f in folders_in(root) if re.match(f"[{part or 'iv'}]_", f.name)]
    if not scenes:
        raise EvalError(f"{root}: no scene folders i_* or v_*: not HPatches' layout")
    for name in sorted(set(wanted) - {f.name for f in scenes}):
        with spec.whole(name):
            raise EvalError(f"{root}: no scene {name!r}; there are {[f.name for f in scenes]}")
    return [f for f in scenes if not wanted or f.name in wanted]


def scene_pairs(folder: Path) -> list[Pair]:
    """Image 1 against each other one.

    Raises
    ------
    EvalError
        Where an image has no homography or a homography no image.
    """
    numbers = {int(m[1]) for p in folder.iterdir() if (m := re.fullmatch(r"(\d+)\.\w+", p.name))}
    numbers |= {int(m[1]) for p in folder.iterdir() if (m := re.fullmatch(r"H_1_(\d+)", p.name))}
    others = sorted(numbers - {1})
    if not others:
        raise EvalError(f"{folder}: expected images 1.*, 2.*, ... and homographies H_1_2, ...")
    first = reference(folder)
    return [Pair(folder.name, first, _image(folder, k), read_homography(folder / f"H_1_{k}")) for k in others]


def reference(folder: Path) -> ImageRef:
    """Image 1 of a scene."""
    return _image(folder, 1)


def _image(folder: Path, number: int) -> ImageRef:
    path = only_image(folder, str(number))
    return ImageRef(f"{folder.name}/{path.name}", path)
