"""Memory for the images that go through the network at once: small ones together, large ones one after the other."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from elf_runtime.params import DetectionParams

MOST = 1_000_000_000  # bytes
LARGE = MOST // 2


def memory_needed(size: tuple[int, int], params: DetectionParams) -> float:
    """Bytes that the detection takes for an image of (height, width), roughly: 28 a pixel of it, 500 a working pixel.

    Measured with the bundled model; networks with more channels take more.
    """
    scales = params.scales_for(size)
    return size[0] * size[1] * (28 + 500 * max(scales) ** 2)


class Room:
    """Lets images in while they need at most `MOST` bytes together; one that needs more goes alone."""

    def __init__(self) -> None:
        self._inside = 0.0
        self._changed = threading.Condition()

    @contextmanager
    def __call__(self, needed: float) -> Iterator[None]:
        taken = min(needed, MOST)
        with self._changed:
            self._changed.wait_for(lambda: self._inside + taken <= MOST)
            self._inside += taken
        try:
            yield
        finally:
            with self._changed:
                self._inside -= taken
                self._changed.notify_all()
