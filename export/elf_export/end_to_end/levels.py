"""Scores and the level that they must reach, as `elf_runtime.detection.threshold` and `entropy` have them."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime import DetectionParams
from elf_runtime.detection.rounding import SHIFT

from .emit import DOUBLE, FLOAT, INT64, Emit, Value, f32, f64, i64

_BINS = 256


def scores_and_level(e: Emit, saliency: str, params: DetectionParams, allowed: str, threshold: str) -> tuple[str, str]:
    """The denoised saliency, (1, 1, h, w), and the lowest score that passes, float32 ().

    Parameters
    ----------
    saliency : (1, h, w) float32, >= 0
    allowed : (h, w) bool
        Whose quantile the range is, and whose histogram the level.
    threshold : float32 ()
        In place of Kapur's level, a fraction of the range; below 0, Kapur's.
    """
    level_map = _normalized(e, saliency, params, allowed)
    scores = blurred(e, level_map, params.denoise, params.quantize)
    smooth = blurred(e, e("Min", level_map, f32(255)), params.threshold_blur, params.quantize)
    fixed = e("Mul", threshold, f32(255))
    return scores, e("Where", e("Less", threshold, f32(0)), _kapur(e, _histogram(e, smooth, allowed)), fixed)


def _normalized(e: Emit, saliency: str, params: DetectionParams, allowed: str) -> str:
    """(1, 1, h, w): divided by its quantile, or by its maximum where that is 0, times 255; 0 for a map of zeros.

    The quantile q of n values is the smallest that at least ceil(q n) of them do not exceed: the k-th largest with
    k = n - ceil(q n) + 1.
    """
    values = e("Where", e.flat(allowed), e.flat(saliency), f32(-1))
    most = e("ReduceMax", values, keepdims=0)
    top = most
    if params.normalize < 1.0:
        n = e("ReduceSum", e.cast(e.flat(allowed), DOUBLE), keepdims=0)
        below = e("Max", e("Ceil", e("Mul", n, f64(params.normalize))), f64(1))
        k = e("Max", e.cast(e("Add", e("Sub", n, below), f64(1)), INT64), i64(1))
        quantile = e("ReduceMin", e.top(values, k, sort=False)[0], keepdims=0)
        top = e("Where", e("Greater", quantile, f32(0)), quantile, most)
    safe = e("Where", e("Greater", top, f32(0)), top, f32(np.inf))
    scaled = e("Mul", saliency, e("Div", f32(255), safe))
    if params.quantize:
        scaled = e("Floor", e("Min", scaled, f32(255)))
    return e("Unsqueeze", scaled, np.array([1], i64))


def blurred(e: Emit, x: str, blur: tuple[int, float], quantize: bool = False) -> str:
    """A ``mu x mu`` Gaussian of standard deviation sigma, mirrored about the outermost pixels; (1, 1, h, w)."""
    mu, sigma = blur
    if mu == 1:
        return x
    if quantize:
        kernel = _kernel_of_bytes(mu, sigma)
        return e("Floor", e("Add", separable(e, x, kernel, kernel), f32(0.5)))
    at = np.arange(mu) - (mu - 1) / 2
    kernel = np.exp(-(at**2) / (2 * sigma**2))
    kernel = kernel / kernel.sum()
    return separable(e, x, kernel, kernel)


def rounded(e: Emit, scores: str) -> str:
    """To the significant bits of `elf_runtime.detection.rounding`; bytes have no more."""
    total = e("Add", e("Mul", scores, SHIFT), scores)
    return e("Sub", total, e("Sub", total, scores))


def _kernel_of_bytes(mu: int, sigma: float) -> npt.NDArray[np.float64]:
    """The kernel that OpenCV blurs bytes with, in whole 256ths, as it shows itself on a bright pixel.

    Products of two and a byte are whole 65536ths, which float32 holds and adds up exactly.
    """
    pixel = np.zeros((1, 2 * mu - 1), np.uint8)
    pixel[0, mu - 1] = 255
    seen = cv2.GaussianBlur(pixel, (mu, 1), sigma)[0, mu // 2 : mu // 2 + mu].astype(np.float64)
    return np.asarray(np.floor(seen * 256 / 255 + 0.5) / 256)


def separable(e: Emit, x: str, along_x: Value, along_y: Value) -> str:
    """Correlation of (1, 1, h, w) with the product of two odd kernels of one length, mirrored at the border."""
    kx, ky = (np.asarray(k, f32) for k in (along_x, along_y))
    x = mirrored(e, x, len(kx) // 2)
    return e("Conv", e("Conv", x, kx.reshape(1, 1, 1, -1)), ky.reshape(1, 1, -1, 1))


def mirrored(e: Emit, x: str, r: int) -> str:
    """(N, C, h, w) with r pixels more on each side, mirrored about the outermost ones."""
    return e("Pad", x, np.array([0, 0, r, r, 0, 0, r, r], i64), mode="reflect")


def _histogram(e: Emit, smooth: str, allowed: str) -> str:
    """Allowed pixels in each of 256 bins [i, i + 1), the last one closed; (256,) float64.

    With a bin's number as 16 a + b, counts are the product of the one-hot matrices of a and b.
    """
    bins = e("Min", e("Floor", e.flat(smooth)), f32(_BINS - 1))
    high = e("Floor", e("Mul", bins, f32(1 / 16)))
    low = e("Sub", bins, e("Mul", high, f32(16)))
    digits = np.arange(16, dtype=f32)[:, None]
    first = e.cast(e("And", e("Equal", high, digits), e.flat(allowed)), FLOAT)
    second = e("Transpose", e.cast(e("Equal", low, digits), FLOAT), perm=[1, 0])
    return e.cast(e.flat(e("MatMul", first, second)), DOUBLE)


def _kapur(e: Emit, counts: str) -> str:
    """Kapur's level as `elf_runtime.entropy` has it, plus 1: the lowest value above it; 0 where there is none."""
    p = e("Div", counts, e("Max", e("ReduceSum", counts, keepdims=0), f64(1)))
    safe = e("Where", e("Greater", p, f64(0)), p, f64(1))
    entropy = e("Neg", e("Mul", p, e("Log", safe)))
    below, h_below = (_part(e, e("CumSum", v, i64(0)), 0) for v in (p, entropy))
    above, h_above = (_part(e, e("CumSum", v, i64(0), reverse=1), 1) for v in (p, entropy))
    valid = e.both(e("Greater", below, f64(0)), e("Greater", above, f64(0)))
    total = None
    for mass, h in ((below, h_below), (above, h_above)):
        some = e("Where", valid, mass, f64(1))
        part = e("Add", e("Log", some), e("Div", h, some))
        total = part if total is None else e("Add", total, part)
    assert total is not None
    best = e("ArgMax", e("Where", valid, total, f64(-1)), axis=0, keepdims=0)  # entropies are not below 0
    found = e("ReduceMax", e.cast(valid, FLOAT), keepdims=0)
    return e("Mul", found, e.cast(e("Add", best, i64(1)), FLOAT))


def _part(e: Emit, x: str, first: int) -> str:
    return e("Slice", x, np.array([first], i64), np.array([first + _BINS - 1], i64), np.array([0], i64))
