"""Kapur's level: the one that leaves the most entropy in the two classes of a histogram."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


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
    total = class_entropies(histogram)
    return int(np.argmax(total)) if np.isfinite(total).any() else -1


def class_entropies(histogram: npt.NDArray[np.integer] | npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """H(t) of `kapur`, (L - 1,), in nats: the entropies of both classes together; -inf where a class is empty."""
    counts = np.asarray(histogram, np.float64)
    if not counts.any():
        return np.full(len(counts) - 1, -np.inf)
    p = counts / counts.sum()
    entropy = -p * np.log(p, out=np.zeros_like(p), where=p > 0)
    below, h = np.cumsum(p)[:-1], np.cumsum(entropy)[:-1]
    # The classes' masses, each from its own end: 1 - cumsum would leave rounding dust in an empty class.
    above, h_above = np.cumsum(p[::-1])[::-1][1:], np.cumsum(entropy[::-1])[::-1][1:]
    valid = (below > 0) & (above > 0)
    total = np.full(below.shape, -np.inf)
    b, a = below[valid], above[valid]
    total[valid] = np.log(b) + h[valid] / b + np.log(a) + h_above[valid] / a
    return total
