"""A scene with depth, as a camera sees it, and folders of images and features for elf-match."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from elf_runtime import Features
from helpers import textured

# A wall and three boards before it: depth, then left, top, right, bottom, in the first camera's coordinates.
PLANES = ((9.0, -9, -9, 9, 9), (6.0, -3.4, -2.6, -0.6, 0.2), (5.0, 0.5, -1.2, 2.6, 1.4), (6.5, -2.6, 0.7, 0.2, 2.9))
DOTS = 60.0  # of a texture for each unit of length


def rendered(K: np.ndarray, rotation: np.ndarray, translation: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(H, W, 3): every pixel's ray is followed to the plane that it meets first."""
    height, width = size
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(K).T @ rotation  # R^T, on each row
    centre = -rotation.T @ translation
    image, nearest = np.zeros((height, width, 3), np.uint8), np.full((height, width), np.inf)
    for number, (depth, left, top, right, bottom) in enumerate(PLANES):
        far = (depth - centre[2]) / rays[..., 2]
        u, v = centre[0] + far * rays[..., 0], centre[1] + far * rays[..., 1]
        texture = textured(int((bottom - top) * DOTS), int((right - left) * DOTS), seed=number)
        places = (((u - left) * DOTS).astype(np.float32), ((v - top) * DOTS).astype(np.float32))
        seen = (u > left) & (u < right) & (v > top) & (v < bottom) & (far > 0) & (far < nearest)
        image[seen] = cv2.remap(texture, *places, cv2.INTER_LINEAR)[seen]
        nearest[seen] = far[seen]
    return image


def write_views(folder: Path, names: list[str], shift: int = 16) -> None:
    """Views of one plane, each moved by `shift` pixels from the one before; a multiple of the tiny model's stride."""
    scene = textured(120, 160 + shift * len(names))
    for number, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name), scene[:, shift * number : shift * number + 160])


def random_features(seed: int, around: np.ndarray, count: int = 40) -> Features:
    """Features whose descriptors lie around some directions, (K, D)."""
    rng = np.random.default_rng(seed)
    rows = around[rng.integers(0, len(around), count)] + 0.4 * rng.standard_normal((count, around.shape[1]))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    points = rng.uniform(0, 100, (count, 2)).astype(np.float32)
    return Features(points, np.ones(count, np.float32), rows.astype(np.float32), (100, 100))
