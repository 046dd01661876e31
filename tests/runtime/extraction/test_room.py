"""How many images are in the network at once."""

from __future__ import annotations

import threading
import time

import pytest

from elf_runtime import DetectionParams
from elf_runtime.extraction.overlap import overlapped
from elf_runtime.extraction.room import MOST, Room, memory_needed


def test_memory_needed() -> None:
    assert memory_needed((480, 640), DetectionParams()) == 480 * 640 * 528
    assert memory_needed((480, 640), DetectionParams(scales=(0.5, 1.0))) == 480 * 640 * 528
    large, capped = (memory_needed((3000, 4000), DetectionParams(scale=0.5, max_side=side)) for side in ("none", 400))
    assert (large, capped) == (12e6 * 153, pytest.approx(12e6 * 28 + 300 * 400 * 500))


@pytest.mark.parametrize(("needed", "most"), [(MOST / 4, 4), (MOST * 0.4, 2), (MOST * 0.6, 1), (MOST * 50, 1)])
def test_small_images_go_together_and_large_ones_alone(needed: float, most: int) -> None:
    room, lock, inside, seen = Room(), threading.Lock(), [0], []

    def work(_: int) -> None:
        with room(needed):
            with lock:
                inside[0] += 1
                seen.append(inside[0])
            time.sleep(0.02)
            with lock:
                inside[0] -= 1

    list(overlapped(work, range(12), 6))
    assert max(seen) == most
