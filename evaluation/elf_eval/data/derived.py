"""Sets made from single images: rotation, scale, random homographies.

`warp_image` makes the views from the resized image, on the same canvas and with the same bits everywhere.  In pixels
of the file the two images of a pair are the same, so the ground truth there is the identity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from elf_eval.errors import EvalError
from elf_eval.spec import Spec, comma_separated

from .dataset import Dataset, Pair
from .files import images_in
from .hpatches import reference, scene_folders
from .images import ImageRef
from .truth import Homography
from .views import RandomHomography, Rotation, View, Zoom

ANGLES: tuple[float, ...] = (0, 40, 80, 120, 160, 200)  # in the authors' logs 10, 50, 90, 130, 170 and 210
FACTORS: tuple[float, ...] = (1.25, 1.5, 1.75, 2.0)


def rotation(spec: Spec) -> Dataset:
    """``rotation:FOLDER`` in HPatches' layout: image 1 of each scene against itself, turned.

    Option ``angles=A,B,...`` in degrees, by default `ANGLES`.  0 is the image itself, which raises the mean.
    """
    angles = spec.take("angles", _numbers, ANGLES)
    return _from_references(spec, "rotation (degrees)", [(angle, Rotation(angle)) for angle in angles])


def scale(spec: Spec) -> Dataset:
    """``scale:FOLDER`` in HPatches' layout: image 1 of each scene against itself, zoomed in.

    Option ``factors=A,B,...``, by default `FACTORS`.
    """
    factors = spec.take("factors", _numbers, FACTORS)
    if min(factors) <= 0.0:
        raise EvalError(f"{spec.text}: option factors: a factor is above 0")
    return _from_references(spec, "scale", [(factor, Zoom(factor)) for factor in factors])


def _numbers(text: str) -> tuple[float, ...]:
    found = [float(item) for item in text.split(",")]
    if not all(map(math.isfinite, found)) or len(set(found)) < len(found):
        raise ValueError("expected different numbers with commas between them")
    return tuple(int(value) if value.is_integer() else value for value in found)  # 10 and 10.0 are the same view


def _from_references(spec: Spec, parameter: str, views: Sequence[tuple[float, View]]) -> Dataset:
    part = spec.take("part", str, "")
    wanted = comma_separated(spec.take("scenes", str, ""))
    pairs = []
    for folder in scene_folders(spec, part, wanted):
        with spec.whole(folder.name):
            first = replace(reference(folder), exact=True)
            for value, view in views:
                seen = _seen(first, f"{spec.kind}-{value:g}", view)
                pairs.append(Pair(folder.name, first, seen, Homography(), value))
    return Dataset(spec.kind, tuple(pairs), parameter)


def synthetic(spec: Spec) -> Dataset:
    """``synthetic:FOLDER``: every photograph against ``count=5`` random homographies of itself.

    Options ``strength=0.2`` (how far a corner moves, as a share of the width and height) and ``seed=0``.
    """
    count = spec.take("count", int, 5)
    strength = spec.take("strength", float, 0.2)
    seed = spec.take("seed", int, 0)
    if count < 1 or not 0.0 < strength < 0.5 or seed < 0:
        raise EvalError(f"{spec.text}: count is at least 1, strength between 0 and 0.5, seed at least 0")
    pairs = []
    for i, path in enumerate(images_in(spec.folder())):
        first = ImageRef(path.name, path, exact=True)
        for k in range(count):
            view = RandomHomography(seed + i * count + k, strength)
            pairs.append(Pair(path.stem, first, _seen(first, f"homography-{k + 1}", view), Homography()))
    return Dataset("synthetic", tuple(pairs))


def _seen(first: ImageRef, label: str, view: View) -> ImageRef:
    stem, dot, ending = first.name.rpartition(".")
    return replace(first, name=f"{stem}@{label}{dot}{ending}", view=view)
