"""From a saliency map to scores and a mask: normalisation, blurs, and Kapur's threshold."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.params import DetectionParams
from elf_runtime.values import Blur

Array = npt.NDArray[np.float32]
Scores = npt.NDArray[np.number]  # float32 or uint8
Mask = npt.NDArray[np.bool_]


def kapur(histogram: npt.NDArray[np.integer] | npt.NDArray[np.floating]) -> int:
    """Kapur's maximum-entropy threshold of a histogram.

    Kapur, Sahoo, Wong, "A new method for gray-level picture thresholding using the entropy of the histogram",
    CVGIP 1985.  With p the normalised histogram and P_t = p_0 + ... + p_t, the level t maximises

        H(t) = H(p_0..p_t / P_t) + H(p_{t+1}..p_{L-1} / (1 - P_t))
             = ln P_t + h_t / P_t  +  ln (1 - P_t) + (h_{L-1} - h_t) / (1 - P_t),   h_t = -sum_{i<=t} p_i ln p_i

    Parameters
    ----------
    histogram : (L,) counts

    Returns
    -------
    int
        t in [0, L-2]: bins <= t are background, bins > t are foreground.  The first maximiser on ties.
        -1 where no level leaves both classes non-empty (fewer than two occupied bins).
    """
    counts = np.asarray(histogram, np.float64)
    if np.count_nonzero(counts) < 2:
        return -1
    p = counts / counts.sum()
    entropy = -p * np.log(p, out=np.zeros_like(p), where=p > 0)
    below, h = np.cumsum(p)[:-1], np.cumsum(entropy)[:-1]
    # The classes' masses, each from its own end: 1 - cumsum would leave rounding dust in an empty class.
    above, h_above = np.cumsum(p[::-1])[::-1][1:], np.cumsum(entropy[::-1])[::-1][1:]
    valid = (below > 0) & (above > 0)
    total = np.full(below.shape, -np.inf)
    b, a = below[valid], above[valid]
    total[valid] = np.log(b) + h[valid] / b + np.log(a) + h_above[valid] / a
    return int(np.argmax(total))


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
    passed = scores >= level if (level := _level(scores, smooth, params, allowed)) > 0 else scores > 0
    return passed if allowed is None else passed & allowed


def _level(scores: Scores, smooth: Scores, params: DetectionParams, allowed: Mask | None) -> float:
    """The lowest score that passes; 0 where all above 0 do: a zero score is no keypoint, whatever the level."""
    if params.threshold == "none":
        return 0.0
    if params.threshold == "kapur":
        # A float map has the same 256 bins as an 8-bit one: [i, i+1), the last one closed.
        # Counts come as float32: exact up to 2^24 pixels in one bin.
        of = None if allowed is None else allowed.view(np.uint8)
        counts = cv2.calcHist([smooth.astype(np.uint8, copy=False)], [0], of, [256], [0, 256]).ravel()
        level = float(kapur(counts) + 1)  # the lowest value of the bins above; 0 where one bin holds everything
    else:
        level = 255.0 * float(params.threshold)
    if scores.dtype == np.uint8:
        level = int(np.ceil(np.float32(level)))  # the same pixels, without a detour through floats
    return level
