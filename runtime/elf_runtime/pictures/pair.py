"""A picture of two images with their matches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError
from elf_runtime.image.file import ImageLike
from elf_runtime.indices import pairs_of

from .canvas import Picture
from .render import match_picture
from .source import pixels_of

if TYPE_CHECKING:
    from elf_runtime.results.features import Features
    from elf_runtime.results.matches import Matches


def draw_matches(
    image_a: ImageLike,
    a: Features,
    image_b: ImageLike,
    b: Features,
    matches: Matches | npt.ArrayLike,
    inliers: npt.ArrayLike | None = None,
    color: str = "bgr",
) -> Picture:
    """Two images side by side, under their counts of keypoints and matches, with a line for each match.

    Parameters
    ----------
    image_a, image_b : arrays or paths, as `ElfRuntime.detect` takes them
        Those that the features came from.
    a, b : Features
    matches : Matches, or (K, 2) integers
        Indices into `a` and `b`, as of `match`, or `TwoView.indices`.
    inliers : (K,) bool, optional
        As `TwoView.inliers`: green lines over the others' thin red ones.  Without it each match has its own colour.
    color : "bgr" or "rgb"
        The order of the arrays' channels.

    Returns
    -------
    (h, w, 3) uint8
        In BGR.  An image of more than 800 pixels is shrunk to that, a tiny one enlarged.

    Raises
    ------
    ImageError
        As `draw_keypoints`.
    SettingError
        If matches are no indices of these features, or there are not as many inliers.
    """
    images = [pixels_of(image, found, color) for image, found in ((image_a, a), (image_b, b))]
    pairs = pairs_of(matches, (len(a), len(b)))
    counts = f"{len(a)} keypoints, {len(pairs)} matches"
    good = None
    if inliers is not None:
        good = np.asarray(inliers)
        if good.shape != (len(pairs),) or good.dtype != np.bool_:
            raise SettingError(f"inliers are {len(pairs)} booleans, not {good.shape} {good.dtype}")
        counts += f", {int(good.sum())} inliers"
    points = (a.keypoints[pairs[:, 0]], b.keypoints[pairs[:, 1]])
    return match_picture(images, points, good, (("", counts), ("", f"{len(b)} keypoints")))
