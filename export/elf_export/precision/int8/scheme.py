"""8-bit numbers for real ones: unsigned integers q that stand for scale (q - zero)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]

LEVELS = 255
# Of weights, on either side of zero.  x86 processors without VNNI add two products of 8 bits in 16 bits, which must
# hold 2 * 255 * 63; the eighth bit of the weights was not seen in any result.
WEIGHT_LEVELS = 63
# Clipping the rarest values costs less than the finer steps for all others gain, up to some point: these shares
# of the largest magnitude are tried.
SHARES = np.geomspace(1.0, 0.1, 40)


@dataclass(frozen=True)
class Scheme:
    """How a tensor is rounded: x becomes scale (clip(round(x / scale) + zero, 0, 255) - zero).

    Unsigned integers throughout: x86's 8-bit dot products multiply unsigned activations by signed weights.
    """

    scale: float
    zero: int = 0

    def rounded(self, x: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        q = np.clip(np.rint(x / self.scale) + self.zero, 0, LEVELS)
        return np.asarray((q - self.zero) * self.scale, np.float64)


MASK = Scheme(1.0 / LEVELS)  # zeros and ones


def fitted(values: Array) -> Scheme:
    """The scheme that loses least of `values`, in the sum of squares, among several clipping ranges.

    Values that are never negative get all levels above zero; others a range that is symmetric about it, so
    that zero, which pads, stays exact.
    """
    top = float(np.abs(values).max(initial=0.0))
    if not top > 0.0:
        return Scheme(1.0 / LEVELS)
    signed = bool((values < 0).any())
    wide = values.astype(np.float64)
    trials = [Scheme(top * share / 127, 128) if signed else Scheme(top * share / LEVELS) for share in SHARES]
    losses = [float(np.square(trial.rounded(wide) - wide).sum()) for trial in trials]
    best = trials[int(np.argmin(losses))]
    return Scheme(float(np.float32(best.scale)), best.zero)


def reaching(top: float) -> Scheme:
    """The scheme from 0 to `top`, a float32, such that the product of scale and 255 in float32 is `top` itself."""
    near = np.float32(top / LEVELS)
    steps = (near, np.nextafter(near, np.float32(0)), np.nextafter(near, np.float32(np.inf)))
    return Scheme(float(next((s for s in steps if s * np.float32(LEVELS) == np.float32(top)), near)))


def weights(kernel: npt.NDArray[np.floating]) -> tuple[npt.NDArray[np.int8], npt.NDArray[np.float32]]:
    """int8 weights and one scale for each output channel (the first axis): kernel = q * scale.

    Returns
    -------
    q : as `kernel`, in -63..63
    scales : (K,) float32
    """
    largest = np.abs(kernel).max(axis=tuple(range(1, kernel.ndim)))
    scales = (np.where(largest > 0, largest, 1.0) / WEIGHT_LEVELS).astype(np.float32)
    shaped = scales.reshape(-1, *[1] * (kernel.ndim - 1)).astype(np.float64)
    return np.clip(np.rint(kernel / shaped), -WEIGHT_LEVELS, WEIGHT_LEVELS).astype(np.int8), scales
