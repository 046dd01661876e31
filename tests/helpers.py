"""What all tests share: where the models and the optional development data are."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

ROOT = Path(__file__).parents[1]
TINY = Path(__file__).parent / "data" / "tiny.onnx"

def shared(*parts: str) -> Path:
    """A file of the development data beside the checkout; skips the test where it is absent."""
    roots = [Path(os.environ["ELF_SHARED"])] if "ELF_SHARED" in os.environ else []
    for root in (*roots, ROOT.parent / "shared", ROOT.parents[1] / "shared"):
        if root.joinpath(*parts).exists():
            return root.joinpath(*parts)
    pytest.skip(f"development data {'/'.join(parts)} is not beside this checkout")


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
