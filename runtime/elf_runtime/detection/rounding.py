"""Scores rounded so coarsely that the rounding of the arithmetic before no longer decides between equal ones."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Scores = npt.NDArray[np.number]  # float32 or uint8

BITS = 14
"""Significant bits of a score: neighbouring values differ by a 16384th to an 8192nd."""

SHIFT = np.float32(2 ** (24 - BITS))


def rounded(scores: Scores) -> Scores:
    """`scores` rounded to `BITS` significant bits; uint8, which have no more, as they are.

    Along a straight edge all places are equally salient, but processors, numbers of threads and runtimes differ in
    the last of a float's 24 bits.  Of what is equal after this, the first in raster order precedes.

    With t = SHIFT x + x, which has its last bit where the result's is to be, it is t - (t - x): Dekker's splitting, "A
    floating-point technique for extending the available precision", 1971.  Fused operations change nothing, as SHIFT x
    is exact.  The order of any two is kept, or they become equal.

    Parameters
    ----------
    scores : float32, >= 0 and below 2^115; or uint8
    """
    if scores.dtype == np.uint8:
        return scores
    values = np.asarray(scores, np.float32)
    total = values * SHIFT
    total += values
    total -= total - values
    return total
