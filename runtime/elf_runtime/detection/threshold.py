"""From a saliency map to scores and a mask: normalisation, blurs, and Kapur's threshold."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.entropy import kapur
from elf_runtime.params import DetectionParams
from elf_runtime.values import Blur

Array = npt.NDArray[np.float32]
Scores = npt.NDArray[np.number]  # float32 or uint8
Mask = npt.NDArray[np.bool_]


def gaussian(image: Scores, blur: Blur) -> Scores:
    """``mu x mu`` Gaussian blur of standard deviation sigma, mirrored at the border (OpenCV's default)."""
    size, sigma = blur
    if size == 1:
        return image
    return np.asarray(cv2.GaussianBlur(image, (size, size), sigma))


def normalized(saliency: Array, params: DetectionParams, allowed: Mask | None = None) -> Scores:
    """`saliency` scaled so that its maximum, or the quantile ``params.normalize``, becomes 255.

    Parameters
    ----------
    saliency : (H, W) float32, >= 0
    allowed : (H, W) bool, optional
        Where keypoints may be, if not everywhere: maximum and quantile are those of these pixels.

    Returns
    -------
    (H, W) float32, >= 0, above 255 only beyond the quantile; where ``params.quantize``, uint8, saturating at 255.
    All zero for an all-zero map.
    """
    values = saliency if allowed is None else saliency[allowed]
    top = quantile(values, params.normalize)
    if not top > 0.0:
        top = float(values.max(initial=0.0))
    scaled = saliency * np.float32(255.0 / top) if top > 0.0 else np.zeros(saliency.shape, np.float32)
    return _cut(scaled, out=scaled).astype(np.uint8) if params.quantize else scaled


def _cut(values: Scores, out: Scores | None) -> Scores:
    """`values`, cut off at 255."""
    return np.asarray(cv2.threshold(values, 255.0, 255.0, cv2.THRESH_TRUNC, dst=out)[1])


def quantile(values: Array, q: float) -> float:
    """The smallest of `values` that at least the share `q` of them does not exceed; 0 of none."""
    if values.size == 0:
        return 0.0
    if q == 1.0:
        return float(values.max())
    index = min(int(np.ceil(q * values.size)) - 1, values.size - 1)
    return float(np.partition(values.ravel(), index)[index])


def scores_and_mask(saliency: Array, params: DetectionParams) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Denoised scores, and the pixels that pass the threshold: `blurred`, then `passing`.

    Parameters
    ----------
    saliency : (H, W) float32, >= 0

    Returns
    -------
    scores : (H, W) float32, >= 0
    mask : (H, W) bool
    """
    scores, smooth = blurred(saliency, params)
    return scores.astype(np.float32, copy=False), passing(scores, smooth, params)


def blurred(saliency: Array, params: DetectionParams, allowed: Mask | None = None) -> tuple[Scores, Scores]:
    """The two blurs of the saliency, `normalized`.

    Returns
    -------
    scores : (H, W) float32, >= 0; uint8 where ``params.quantize``
        Blurred by `denoise`: its maxima are the keypoints.
    smooth : (H, W) float32 in [0, 255]; uint8 where ``params.quantize``
        Blurred by `threshold_blur`: Kapur's level is chosen from it.  `scores` where none is.
    """
    level_map = normalized(saliency, params, allowed)
    scores = gaussian(level_map, params.denoise)
    if params.threshold != "kapur":
        return scores, scores
    if params.normalize < 1.0 and not params.quantize:
        # Cut off for the level only: maxima cut off would be plateaus, without a place.
        level_map = _cut(level_map, out=None if scores is level_map else level_map)
    return scores, gaussian(level_map, params.threshold_blur)


def passing(scores: Scores, smooth: Scores, params: DetectionParams, allowed: Mask | None = None) -> Mask:
    """The pixels, of those `allowed`, whose score reaches the level: Kapur's of `smooth`, or a fraction of the range.

    The level comes from the one blur and is held against the other: the paper chooses it on the map blurred for
    that, and then keeps the maxima of the denoised map above it.  Pixels that are not allowed have no part in the
    level: the edge of a black surround would raise it.

    Returns
    -------
    (H, W) bool
    """
    return reaching(scores, lowest_passing(scores, smooth, params, allowed)[0], allowed)


def reaching(scores: Scores, level: float, allowed: Mask | None = None) -> Mask:
    """The pixels, of those `allowed`, whose score is at least `level`, and above 0."""
    passed = scores >= level if level > 0 else scores > 0
    return passed if allowed is None else passed & allowed


def lowest_passing(
    scores: Scores, smooth: Scores, params: DetectionParams, allowed: Mask | None = None
) -> tuple[float, Array | None]:
    """The lowest score that passes, and the histogram, (256,), that Kapur's level is chosen from; None without it.

    0 where all above 0 pass: a zero score is no keypoint, whatever the level.
    """
    if params.threshold == "none":
        return 0.0, None
    counts = None
    if params.threshold == "kapur":
        counts = histogram(smooth, allowed)
        level = float(kapur(counts) + 1)  # the lowest value of the bins above; 0 where one bin holds everything
    else:
        level = 255.0 * float(params.threshold)
    if scores.dtype == np.uint8:
        level = int(np.ceil(np.float32(level)))  # the same pixels, without a detour through floats
    return level, counts


def histogram(smooth: Scores, allowed: Mask | None = None) -> Array:
    """Pixels, of those `allowed`, in each of 256 bins, (256,): [i, i + 1), the last one closed, as of an 8-bit map.

    Counts come as float32: exact up to 2^24 pixels in one bin.
    """
    of = None if allowed is None else allowed.view(np.uint8)
    return np.asarray(cv2.calcHist([smooth.astype(np.uint8, copy=False)], [0], of, [256], [0, 256]).ravel(), np.float32)
