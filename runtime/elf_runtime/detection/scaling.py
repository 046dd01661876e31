"""The two pixel grids of a detection: the source image's, and that of the working image, which the network sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Scaling:
    """Places and lengths between the source image and the working image, whose corners coincide.

    Attributes
    ----------
    source, working : (height, width)
    scale : float
        Working pixels for a source pixel; rounded to whole pixels, the sizes' ratios may differ from it.
    """

    source: tuple[int, int]
    working: tuple[int, int]
    scale: float

    @property
    def _ratio(self) -> npt.NDArray[np.float64]:
        (height, width), (h, w) = self.source, self.working
        return np.array([w / width, h / height])

    def to_source(self, points: npt.NDArray[Any]) -> Array:
        """Working to source pixels, (N, 2) as (x, y)."""
        return ((points + 0.5) / self._ratio - 0.5).astype(np.float32)

    def to_working(self, points: Array) -> Array:
        """Source to working pixels, (N, 2) as (x, y)."""
        return ((points + 0.5) * self._ratio - 0.5).astype(np.float32)

    def source_pixels(self, points: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        """The pixels (x, y) of the source image that working points lie in; between two, the even one."""
        height, width = self.source
        return np.clip(np.rint(self.to_source(points)), 0, (width - 1, height - 1)).astype(np.int64)

    def radius(self, pixels: int) -> int:
        """A length of the source image to the nearest working pixel: at least 1 if positive, at most the image."""
        most = max(self.working)
        if pixels > most / self.scale:
            return most
        return max(1, round(pixels * self.scale)) if pixels else 0

    def margin(self, border: int) -> tuple[int, int]:
        """The fewest rows and columns along the edges without which every centre lies `border` source pixels inside.

        The centre of working pixel m lies at (m + 1/2) size / working - 1/2.  In integers: nothing is rounded.
        """
        sizes = zip(self.source, self.working, strict=True)
        rows, columns = (min(n, -((size - (2 * border + 1) * n) // (2 * size))) if border else 0 for size, n in sizes)
        return rows, columns
