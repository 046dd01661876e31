"""A detection with what led to it, and how long each stage took."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError
from elf_runtime.pictures.notebook import trace_png

from .features import Array, Features


@dataclass(frozen=True, eq=False)
class Level:
    """What led to the keypoints of one working scale, at its working size (h, w).

    Attributes
    ----------
    scale : float
        The working scale.
    saliency : (h, w) float32
        S(I), as the graph gives it.
    scores : (h, w) float32
        The denoised saliency whose maxima the keypoints are.
    mask : (h, w) bool
        What passed the threshold (and the user's mask).
    threshold : float
        The lowest score that passes, 0 where all above 0 do; NaN where each cell of a grid has a level of its own.
    smooth : (h, w) float32, optional
        The saliency blurred for the threshold, up to 255: Kapur's level is chosen from it.  None in a grid.
    histogram : (256,) float32, optional
        Pixels of `smooth` in [i, i + 1), where keypoints may be; the last bin has 255 too.  None unless the level is
        Kapur's, and in a grid.
    allowed : (h, w) bool, optional
        Where mask and alpha let keypoints be, away from their edges; None where that is everywhere.
    """

    scale: float
    saliency: Array
    scores: Array
    mask: npt.NDArray[np.bool_]
    threshold: float = math.nan
    smooth: Array | None = None
    histogram: Array | None = None
    allowed: npt.NDArray[np.bool_] | None = None


@dataclass(frozen=True, eq=False)
class Trace:
    """A detection with what led to it.

    Attributes
    ----------
    features : Features
    levels : tuple of Level
        Of each working scale, the finest first; none of a file that gives keypoints itself.
    seconds : dict
        Time of each stage: read, prepare, session, blur, threshold, nms, descriptors
        (where keypoints are oriented, with the network's looks at their patches).
    saliency, scores, mask : (h, w) arrays
        Those of the finest level; see `Level`.  Where there is none they raise SettingError.
    """

    features: Features
    levels: tuple[Level, ...]
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def saliency(self) -> Array:
        """S(I) of the finest level."""
        return self._finest.saliency

    @property
    def scores(self) -> Array:
        """What keypoints are the maxima of, at the finest level."""
        return self._finest.scores

    @property
    def mask(self) -> npt.NDArray[np.bool_]:
        """Where the threshold lets keypoints be, at the finest level."""
        return self._finest.mask

    @property
    def _finest(self) -> Level:
        if not self.levels:
            raise SettingError("a file that gives keypoints itself gives no maps; export it without --end-to-end")
        return self.levels[0]

    def __repr__(self) -> str:
        time = f"{1e3 * sum(self.seconds.values()):.1f} ms"
        if not self.levels:
            return f"Trace({self.features!r}, {time})"
        (h, w), share = self.saliency.shape, float(self.mask.mean()) if self.mask.size else 0.0
        return f"Trace({self.features!r}, saliency {w}x{h}, {share:.1%} passed, {time})"

    def _repr_png_(self) -> bytes:
        """In notebooks: keypoints, saliency and threshold side by side; the image as by `Features`."""
        return trace_png(self)


class Stopwatch:
    """Adds up the wall time of named stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start
