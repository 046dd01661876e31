"""What all tests share: where the models and the optional development data are."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

ROOT = Path(__file__).parents[1]
TINY = Path(__file__).parent / "data" / "tiny.onnx"
TINY_ALONE = TINY.with_name("tiny-alone.onnx")


def shared(*parts: str) -> Path:
    """A file of the development data beside the checkout; skips the test where it is absent."""
    roots = [Path(os.environ["ELF_SHARED"])] if "ELF_SHARED" in os.environ else []
    for root in (*roots, ROOT.parent / "shared", ROOT.parents[1] / "shared"):
        if root.joinpath(*parts).exists():
            return root.joinpath(*parts)
    pytest.skip(f"development data {'/'.join(parts)} is not beside this checkout")


@contextmanager
def memory_needed_below(most: float) -> Iterator[None]:
    """Fail where this process comes to need `most` bytes more than it has; what it needed before does not count."""
    status = Path("/proc/self/status")

    def mebibytes(key: str) -> float:
        return next(int(line.split()[1]) / 1024 for line in status.read_text().splitlines() if line.startswith(key))

    if not status.exists():
        yield
        return
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    before = mebibytes("VmRSS")
    yield
    needed = mebibytes("VmHWM") - before
    assert needed < most / 2**20, f"{needed:.0f} MiB"


def textured(height: int, width: int, seed: int = 0, channels: int = 3) -> npt.NDArray[np.uint8]:
    """A picture with blobs and edges at several scales, (H, W, C) uint8."""
    import cv2

    rng = np.random.default_rng(seed)
    total = np.zeros((height, width, channels))
    for step in (4, 9, 21):
        small = rng.standard_normal((height // step + 2, width // step + 2, channels)).astype(np.float32)
        total += cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC).reshape(total.shape) * step**0.5
    low, high = total.min(), total.max()
    return np.round(255 * (total - low) / (high - low)).astype(np.uint8)


def turned_jpeg(image: npt.NDArray[np.uint8], orientation: int = 6) -> bytes:
    """A JPEG of `image` whose EXIF orientation says that it is to be turned; 6 is clockwise."""
    import cv2

    data = cv2.imencode(".jpg", image)[1].tobytes()
    entry = b"\x01\x12\0\3\0\0\0\1" + bytes([0, orientation, 0, 0])
    exif = b"Exif\0\0" + b"MM\0*\0\0\0\x08" + b"\0\1" + entry + bytes(4)
    return data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:]
