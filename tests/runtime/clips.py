"""Short videos."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from helpers import textured

LEVELS = tuple(range(80, 200, 10))  # mean brightness of each frame


def clip(path: Path, levels: tuple[int, ...] = LEVELS) -> Path:
    """A video of 96x128 frames of a textured scene, one for each level."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (128, 96))
    assert writer.isOpened()
    scene = textured(96, 128).astype(np.float64) / 4
    for level in levels:
        writer.write(np.clip(scene - scene.mean() + level, 0, 255).astype(np.uint8))
    writer.release()
    return path
