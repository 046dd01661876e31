"""Subsets of a scene's images that hang together, for structure from motion from few of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elf_eval.data import Pair
from elf_eval.data.images import ImageRef

Subset = tuple[ImageRef, ...]


def draw_subsets(pairs: Sequence[Pair], size: int, count: int, seed: int) -> list[Subset]:
    """`count` different subsets of `size` images of a scene, fewer where there are no more.

    A subset begins with an image at random and grows by one that is in a pair with some image of it, so that its
    images may be expected to show common things.  The same seed draws the same subsets.

    Parameters
    ----------
    pairs : sequence of Pair
        Of one scene.
    """
    neighbours: dict[ImageRef, list[ImageRef]] = {}
    for pair in pairs:
        neighbours.setdefault(pair.first, []).append(pair.second)
        neighbours.setdefault(pair.second, []).append(pair.first)
    images = sorted(neighbours, key=lambda ref: ref.name)
    random = np.random.default_rng([seed, size])
    found: dict[frozenset[ImageRef], None] = {}
    for _ in range(20 * count):  # a draw may end early, or come again
        if len(found) == count:
            break
        chosen = [images[random.integers(len(images))]]
        while len(chosen) < size:
            near = sorted({n for ref in chosen for n in neighbours[ref]} - set(chosen), key=lambda ref: ref.name)
            if not near:
                break
            chosen.append(near[random.integers(len(near))])
        if len(chosen) == size:
            found[frozenset(chosen)] = None
    return [tuple(sorted(subset, key=lambda ref: ref.name)) for subset in found]
