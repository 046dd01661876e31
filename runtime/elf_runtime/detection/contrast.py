"""The contrast around a place, in grey levels, which tells a texture from the noise of a blank wall."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]

LEAST_WINDOW = 11  # working pixels; smaller ones would call a blurred edge blank
_FEW = 25  # up to this window, 500 points cost less than a whole map


def window_for(receptive_field: float, size: tuple[int, int]) -> int:
    """The side of the window, odd: what a cell of the feature map sees, at least 11 pixels, at most the image."""
    side = min(max(LEAST_WINDOW, int(receptive_field)), *size)
    return max(3, side - 1 | 1)


def contrast_map(pixels: Array, window: int) -> Array:
    """Standard deviation, in the window around each pixel, of what is left when a fitted plane is taken away.

    With x, y = -r ... r over the window and E the mean over it,

        contrast^2 = E[g^2] - E[g]^2 - (E[x g]^2 + E[y g]^2) / E[x^2],   E[x^2] = E[y^2] = r (r + 1) / 3,

    averaged over the channels.  A ramp (a wall lit from the side) has none; white noise of deviation s has about s.

    Parameters
    ----------
    pixels : (h, w, C) float32
        Mirrored at the border.
    window : int, odd

    Returns
    -------
    (h, w) float32, in the unit of the pixels
    """
    r = window // 2
    centred = pixels - np.float32(pixels.mean())  # small numbers: a square loses fewer digits
    ones, ramp = np.ones(window) / window, np.arange(-r, r + 1) / window
    mean, along_x, along_y = (
        _channels(cv2.sepFilter2D(centred, cv2.CV_32F, kx, ky)) for kx, ky in ((ones, ones), (ramp, ones), (ones, ramp))
    )
    square = _channels(cv2.sqrBoxFilter(centred, cv2.CV_32F, (window, window)))
    left = square - mean**2 - (along_x**2 + along_y**2) / np.float32(r * (r + 1) / 3)
    return np.asarray(np.sqrt(np.maximum(left.mean(axis=2), 0)), np.float32)


def contrast_at(pixels: Array, points: npt.NDArray[np.int64], window: int) -> Array:
    """`contrast_map` at (N, 2) points (x, y), without the rest of the map."""
    if window > _FEW:
        return np.asarray(contrast_map(pixels, window)[points[:, 1], points[:, 0]])
    r, channels = window // 2, pixels.shape[2]
    framed = _channels(cv2.copyMakeBorder(pixels, r, r, r, r, cv2.BORDER_REFLECT_101))
    # A window is the rows, cut out of all values, that begin so far from its corner.
    rows = np.lib.stride_tricks.sliding_window_view(framed.ravel(), window * channels)
    corners = points[:, 1, None] * framed.shape[1] + points[:, 0, None]
    around = rows[(corners + np.arange(window) * framed.shape[1]) * channels].reshape(len(points), window**2, channels)
    around = around - around.mean(axis=1, keepdims=True)  # (N, window^2, C)
    ramp = np.arange(-r, r + 1, dtype=np.float32)
    slopes = np.stack([np.tile(ramp, window), np.repeat(ramp, window)]) @ around  # (N, 2, C): along x and y
    left = np.einsum("nkc,nkc->nc", around, around) / window**2
    left -= np.einsum("nsc,nsc->nc", slopes, slopes) / np.float32(window**4 * r * (r + 1) / 3)
    return np.asarray(np.sqrt(np.maximum(left.mean(axis=1), 0)), np.float32)


def _channels(found: npt.NDArray[np.floating]) -> Array:
    """(h, w, C): OpenCV drops the axis of a single channel."""
    return np.asarray(found[:, :, None] if found.ndim == 2 else found, np.float32)
