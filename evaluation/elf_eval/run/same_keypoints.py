"""Whether features that another program computed are at the keypoints that they are declared to be at."""

from __future__ import annotations

import numpy as np

from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.suite.suite import MethodEntry

from .cache import load
from .extraction import CachedFeatures

TOLERANCE = 0.5  # pixels of the working image


def check_keypoints(entry: MethodEntry, ref: ImageRef, own: CachedFeatures, of: CachedFeatures) -> None:
    """Refuse features of an image whose keypoints are not those `of` the method that ``entry.keypoints_of`` names.

    Raises
    ------
    EvalError
        If one lies further than `TOLERANCE` from all of those.  There may be fewer: not every descriptor takes every
        keypoint.
    """
    ours, theirs = load(own.path), load(of.path)
    if ours is None or theirs is None:  # damaged since: the metrics refuse it
        return
    points, allowed = ours.features.keypoints, theirs.features.keypoints
    foreign = [p for p in points if not (np.hypot(*(allowed - p).T) <= TOLERANCE).any()]
    if foreign:
        x, y = foreign[0]
        raise EvalError(
            f"method {entry.name!r}: {len(foreign)} of its {len(points)} keypoints of {ref.name} are not within "
            f"{TOLERANCE} px of those of {entry.keypoints_of!r}, first ({x:.1f}, {y:.1f}): describe that method's "
            f"keypoints of the images that elf-eval images writes, found with the same model ({entry.detector})"
        )
