"""Student's t distribution: how far off a mean of few values can be."""

from __future__ import annotations

import math


def two_sided(t: float, freedom: int) -> float:
    """P(\\|T\\| > t) of Student's distribution with `freedom` >= 1 degrees of freedom.

    The finite sums of Abramowitz and Stegun, 26.7.3 and 26.7.4, with theta = atan(t / sqrt(freedom)).
    """
    if math.isinf(t):
        return 0.0
    theta = math.atan(abs(t) / math.sqrt(freedom))
    cosine = math.cos(theta)
    odd = freedom % 2
    term = cosine if odd else 1.0
    total = term if freedom > 1 else 0.0
    for k in range(3 if odd else 2, freedom - 1, 2):
        term *= (k - 1) / k * cosine * cosine
        total += term
    inside = 2.0 / math.pi * (theta + math.sin(theta) * total) if odd else math.sin(theta) * total
    return min(1.0, max(0.0, 1.0 - inside))


def quantile(level: float, freedom: int) -> float:
    """The t that \\|T\\| exceeds with probability 1 - `level`: half the width of an interval of that level."""
    low, high = 0.0, 1.0
    while two_sided(high, freedom) > 1.0 - level:
        high *= 2.0
    for _ in range(60):
        middle = (low + high) / 2.0
        low, high = (middle, high) if two_sided(middle, freedom) > 1.0 - level else (low, middle)
    return high
