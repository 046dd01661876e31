"""Figures of saliency: of a network's layers, with threshold and keypoints, and of the image's own gradients beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from elf_eval.coordinates import Size
from elf_eval.data.images import Image
from elf_eval.methods.elf import Elf
from elf_eval.methods.gradient import Gradient
from elf_runtime import Features
from elf_runtime.pictures.canvas import Picture, side_by_side, stacked, titled
from elf_runtime.pictures.render import draw_keypoints, draw_mask, heatmap

_SIDE = 400  # pixels of a panel's longer side


@dataclass(frozen=True)
class Seen:
    """What a method sees in an image.

    Attributes
    ----------
    title : str
    saliency : (h, w) float32
    mask : (h, w) bool
        What passes the threshold.
    features : Features
    """

    title: str
    saliency: npt.NDArray[np.float32]
    mask: npt.NDArray[np.bool_]
    features: Features


Crop = tuple[int, int, int, int]  # x, y, width, height


def seen_by(method: Elf | Gradient, image: Image, limit: int) -> Seen:
    """The maps of a method, and at most `limit` keypoints."""
    if isinstance(method, Gradient):
        saliency, mask, found = method.trace(image, limit)
        size = (image.size[1], image.size[0])
        none = np.zeros((len(found), 0), np.float32)
        return Seen(method.title, saliency, mask, Features(found.keypoints, found.scores, none, size, 10.0))
    trace = method.trace(image, limit)
    return Seen(method.title, trace.saliency, trace.mask, trace.features)


def layers_figure(image: Image, each: Sequence[Seen], crop: Crop | None = None) -> Picture:
    """A row for each of `each`: saliency, threshold, keypoints; enlarged to a crop where one is given."""
    rows = []
    for seen in each:
        share = 100.0 * float(seen.mask.mean())
        panels = [
            titled(_panel(_resized(heatmap(seen.saliency), image.size), crop), f"{seen.title}: saliency"),
            titled(_panel(draw_mask(image.pixels, seen.mask), crop), f"threshold: {share:.1f} % pass"),
            titled(_panel(draw_keypoints(image.pixels, seen.features), crop), _counted(seen, crop)),
        ]
        rows.append(side_by_side(panels))
    return stacked(rows)


def gradients_figure(image: Image, each: Sequence[Seen], crop: Crop | None = None) -> Picture:
    """A column for each of `each` and one for the image: saliency above, keypoints below."""
    columns = [titled(_panel(image.pixels, crop), "image")]
    columns += [stacked(_column(image, seen, crop)) for seen in each]
    return side_by_side(columns)


def _counted(seen: Seen, crop: Crop | None) -> str:
    return f"{len(seen.features)} keypoints{'' if crop is None else ' in the image'}"


def _column(image: Image, seen: Seen, crop: Crop | None) -> list[Picture]:
    heat, points = _resized(heatmap(seen.saliency), image.size), draw_keypoints(image.pixels, seen.features)
    return [titled(_panel(heat, crop), seen.title), titled(_panel(points, crop), _counted(seen, crop))]


def _resized(picture: Picture, size: Size) -> Picture:
    if (picture.shape[1], picture.shape[0]) == size:
        return picture
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR), np.uint8)


def _panel(picture: Picture, crop: Crop | None) -> Picture:
    if crop is not None:
        x, y, width, height = crop
        picture = picture[y : y + height, x : x + width]
    factor = _SIDE / max(picture.shape[:2])
    method = cv2.INTER_AREA if factor <= 1.0 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(picture, None, fx=factor, fy=factor, interpolation=method), np.uint8)
