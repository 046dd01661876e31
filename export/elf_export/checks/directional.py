"""Derivatives of phi(x) = 1/2 ||F(x)||^2 along directions: by two runs of F, and by a gradient held against them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from .arithmetic import NOISE, Arithmetic, Array64, Forward

DIRECTIONS = 3  # of each family, on each image
# For one direction that crosses no kink; of several the one with the least is kept.  A gate that one number opens may
# lie in the way of most.
TRIES = 6


@dataclass(frozen=True)
class Direction:
    """One derivative, measured and computed.

    `error` is their difference, as a fraction of the larger of the computed derivative and of what a random
    direction of this length has: ||g|| times the rms of v.
    """

    family: str
    size: str
    measured: float
    computed: float
    error: float


def along(
    forward: Forward, x: Array64, f: Array64, g: Array64, size: str, arithmetic: Arithmetic, seed: int
) -> list[Direction]:
    """The derivatives along DIRECTIONS directions of each family.

    Parameters
    ----------
    forward : function
        F of an image like `x`.
    x, f, g : the image, F there, and the gradient of phi
    size : str
        What `Direction.size` says.

    Where F is not finite beside the image on every try, `Direction.measured` is NaN and the error infinite.
    """
    rng = np.random.default_rng(seed)
    spread = float(x.std()) or 1.0
    norm = float(np.sqrt((g * g).sum()))
    result = []
    for family in arithmetic.families:
        for _ in range(DIRECTIONS):
            kept, least = (np.nan, np.nan), np.inf
            for _ in range(TRIES):
                v = _direction(family, g, rng)
                v *= spread / np.sqrt((v * v).mean())
                measured, kink = _derivative(forward, x, f, v, arithmetic)
                kink /= max(abs(measured), norm * spread)
                if kink < least:
                    kept, least = (measured, float((g * v).sum())), kink
                if kink <= arithmetic.typical:
                    break
            measured, computed = kept
            error = abs(measured - computed) / max(abs(computed), norm * spread)
            error = error if np.isfinite(error) else np.inf
            result.append(Direction(family, size, measured, computed, error))
    return result


def _direction(family: str, g: Array64, rng: np.random.Generator) -> Array64:
    if family == NOISE:
        return rng.standard_normal(g.shape)
    signs = np.where(g != 0, np.sign(g), rng.choice([-1.0, 1.0], g.shape))
    return np.asarray(signs * (rng.random(g.shape) < 0.5), np.float64)


def _derivative(forward: Forward, x: Array64, f: Array64, v: Array64, arithmetic: Arithmetic) -> tuple[float, float]:
    """The derivative of phi along `v`, at the two neighbouring steps that agree best, and what a kink may add to it.

    A kink on one side changes the difference by half of what the slopes ahead of `x` and behind differ by.  Curvature
    makes them differ too, in proportion to the step, and cancels in the difference.
    """
    found = [_difference(forward, x, f, v, step) for step in arithmetic.steps]
    apart = [abs(far - near) for (near, _), (far, _) in itertools.pairwise(found)]
    best = int(np.argmin(np.nan_to_num(apart, nan=np.inf)))
    (near, bend_near), (far, bend_far) = found[best : best + 2]
    straight = bend_far - bend_near * arithmetic.steps[best + 1] / arithmetic.steps[best]
    return (near + far) / 2, min(max(abs(bend_near), abs(bend_far)), abs(straight))


def _difference(forward: Forward, x: Array64, f: Array64, v: Array64, step: float) -> tuple[float, float]:
    """The derivative by a central difference, and half of what the slopes ahead and behind differ by."""
    ahead, behind = (forward(x + sign * step * v) for sign in (1, -1))
    if not (np.isfinite(ahead).all() and np.isfinite(behind).all()):
        return np.nan, np.nan

    # (a^2 - b^2) / 2 = (a - b) (a + b) / 2 keeps the digits that two large sums would lose.
    def rise(a: Array64, b: Array64) -> float:
        return float(((a - b) * (a + b)).sum()) / (2 * step)

    return rise(ahead, behind) / 2, (rise(ahead, f) - rise(f, behind)) / 2
