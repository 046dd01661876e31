"""What a dataset is: pairs of images with their ground truth."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from elf_eval.coordinates import Size
from elf_eval.errors import EvalError

from .images import ImageRef
from .truth import Truth


@dataclass(frozen=True)
class Pair:
    """Two images and what is known between them.

    Attributes
    ----------
    scene : str
        Results are averaged per scene, then over scenes.
    first, second : ImageRef
    truth : Truth
    parameter : float, optional
        The angle or factor of a derived pair, on the x axis of its curve.
    """

    scene: str
    first: ImageRef
    second: ImageRef
    truth: Truth
    parameter: float | None = None

    @property
    def name(self) -> str:
        return f"{self.first.name} - {self.second.name}"

    def pixels(self, size: Size | None) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
        """Both images at the working size, (H, W, 3) uint8 BGR."""
        return self.first.open(size).pixels, self.second.open(size).pixels


def is_of(pair: str, scenes: Collection[str]) -> bool:
    """Whether a pair of this name, "v_graf/1.png - v_graf/3.png", is of one of these scenes."""
    return any(pair.startswith(f"{scene}/") for scene in scenes)


@dataclass(frozen=True)
class Dataset:
    """Pairs, in a fixed order.

    Attributes
    ----------
    name : str
    pairs : tuple of Pair
    parameter : str, optional
        What `Pair.parameter` is, e.g. "rotation (degrees)".
    """

    name: str
    pairs: tuple[Pair, ...]
    parameter: str | None = None

    def scenes(self) -> list[str]:
        """Names of the scenes, in the order of the pairs."""
        return list(dict.fromkeys(pair.scene for pair in self.pairs))

    def pair(self, name: str) -> Pair:
        """The pair of this name, such as "v_graf/1.png - v_graf/3.png"; EvalError where there is none."""
        for pair in self.pairs:
            if pair.name == name:
                return pair
        raise EvalError(f"no such pair in {self.name}, which has {self.pairs[0].name!r}, ...")

    def only(self, scenes: Collection[str]) -> Dataset:
        """The pairs of these scenes."""
        return replace(self, pairs=tuple(pair for pair in self.pairs if pair.scene in scenes))

    def images(self) -> Iterator[ImageRef]:
        """Every image once, in the order of the pairs."""
        yield from dict.fromkeys(image for pair in self.pairs for image in (pair.first, pair.second))
