"""Where in an image keypoints may be: masks, alpha channels, and the distance from their edges."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ImageError


def seen(image: npt.NDArray[Any], mask: npt.ArrayLike | None) -> npt.NDArray[np.bool_] | None:
    """Where a user's mask and the image's alpha allow keypoints, (H, W); None where that is everywhere.

    Raises
    ------
    ImageError
        As `to_mask`.
    """
    allowed = None if mask is None else to_mask(mask, (image.shape[0], image.shape[1]))
    if image.ndim == 3 and image.shape[2] == 4:
        opaque = image[:, :, 3] > 0
        if not opaque.all():
            allowed = opaque if allowed is None else allowed & opaque
    return allowed


def shrunk(mask: npt.NDArray[np.bool_], pixels: int) -> npt.NDArray[np.bool_]:
    """The mask without the pixels that lie so near, along x and y, to a pixel that it leaves out."""
    pixels = min(pixels, max(mask.shape))
    if pixels == 0:
        return mask
    # One axis at a time: OpenCV's time then grows with the sides of the window and not with its area.
    found = mask.view(np.uint8)
    for side in ((2 * pixels + 1, 1), (1, 2 * pixels + 1)):
        found = np.asarray(cv2.erode(found, np.ones(side, np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=1))
    return found.view(np.bool_)


def to_mask(mask: Any, size: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """A user's mask as booleans; True = keypoints allowed.

    Parameters
    ----------
    mask : (H, W) or (H, W, 1) bool or integer array, of the source image's `size`

    Raises
    ------
    ImageError
        If it is of another shape or dtype.
    """
    array = np.asarray(mask)
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if array.shape != size:
        raise ImageError(f"the mask has shape {array.shape}, the image {size}")
    if array.dtype != np.bool_ and array.dtype.kind not in "ui":
        raise ImageError(f"a mask is bool or integer (non-zero = keypoints allowed), not {array.dtype}")
    return np.asarray(array != 0)
