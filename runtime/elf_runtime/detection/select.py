"""From scores to keypoints at whole working pixels: suppression, border, least contrast, and the grid's shares."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from elf_runtime.params import DetectionParams

from .contrast import contrast_at, contrast_map
from .grid import shared_out
from .nms import Scores, greedy_nms, window_maxima
from .rounding import rounded
from .working_image import WorkingImage

Index = npt.NDArray[np.int64]


def select_keypoints(
    scores: Scores, mask: npt.NDArray[np.bool_], image: WorkingImage, params: DetectionParams
) -> tuple[Index, Scores]:
    """The keypoints among the pixels that passed the threshold, by descending `rounded` score, ties in raster order.

    Parameters
    ----------
    scores : (h, w)
    mask : (h, w) bool
        What passed.  Pixels of less than `min_contrast` are taken out of it, if one of them would be a keypoint.

    Returns
    -------
    points : (N, 2) int64, (x, y) in working pixels
    scores : (N,)
        As they are given.
    """
    found, strength = _suppressed(scores, mask, image, params)
    if params.min_contrast > 0.0:
        # What is no keypoint suppresses nothing: where all of these have enough, the others need not be asked.
        least = np.float32(params.min_contrast / image.gray_levels)
        if (contrast_at(image.pixels, found, image.window) < least).any():
            mask &= contrast_map(image.pixels, image.window) >= least
            found, strength = _suppressed(scores, mask, image, params)
    return found, strength


def _suppressed(
    scores: Scores, mask: npt.NDArray[np.bool_], image: WorkingImage, params: DetectionParams
) -> tuple[Index, Scores]:
    rows, columns = image.scaling.margin(params.border)
    height, width = mask.shape
    inside = (slice(rows, height - rows), slice(columns, width - columns))  # empty where the border is all
    spread = params.grid != (1, 1)
    limit = None if spread else params.max_keypoints
    radius = image.scaling.radius(params.nms_radius)
    ranks = rounded(scores)
    if params.suppression == "maxima":
        mask = mask & window_maxima(ranks, radius)  # what exceeds a pixel need not have passed
    found, strength = greedy_nms(ranks[inside], mask[inside], radius, limit)
    found += (columns, rows)
    if spread:
        found, _ = shared_out(found, strength, (height, width), params.grid, params.max_keypoints)
    return found, scores[found[:, 1], found[:, 0]]
