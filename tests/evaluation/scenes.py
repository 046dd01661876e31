"""Synthetic photographs and datasets."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

SIZE = (200, 160)  # width, height


def photograph(seed: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """(H, W, 3) uint8: rectangles and discs over a soft ground, with corners to find."""
    rng = np.random.default_rng(seed)
    width, height = size
    ground = cv2.GaussianBlur(rng.integers(0, 256, (height, width, 3), np.uint8), (31, 31), 8)
    for _ in range(40):
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        w, h = (int(v) for v in rng.integers(5, 40, 2))
        colour = tuple(int(c) for c in rng.integers(0, 256, 3))
        if rng.random() < 0.5:
            cv2.rectangle(ground, (x, y), (x + w, y + h), colour, -1)
        else:
            cv2.circle(ground, (x, y), w // 2, colour, -1)
    return ground


def write_hpatches(root: Path, scenes: list[str]) -> None:
    """Scenes of three images: image 1, the same darker, and a homography of it."""
    matrix = np.array([[0.95, 0.08, 4.0], [-0.06, 1.02, 3.0], [1e-4, -5e-5, 1.0]])
    for number, name in enumerate(scenes):
        folder = root / name
        folder.mkdir()
        first = photograph(number)
        cv2.imwrite(str(folder / "1.png"), first)
        cv2.imwrite(str(folder / "2.png"), (first * 0.7).astype(np.uint8))
        cv2.imwrite(str(folder / "3.png"), cv2.warpPerspective(first, matrix, SIZE))
        np.savetxt(folder / "H_1_2", np.eye(3))
        np.savetxt(folder / "H_1_3", matrix)
