"""Features at random places, for tests of what is done with features."""

from __future__ import annotations

import numpy as np

from elf_runtime import Features


def scattered(count: int, dim: int = 16, size: tuple[int, int] = (60, 80), seed: int = 0) -> Features:
    """`count` features with descending scores, descriptors of unit length, and sizes and angles of all kinds."""
    rng = np.random.default_rng(seed)
    height, width = size
    rows = rng.standard_normal((count, dim))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    angles = np.where(rng.random(count) < 0.3, -1, rng.uniform(0, 360, count))
    return Features(
        rng.uniform(-0.5, (width - 0.5, height - 0.5), (count, 2)).astype(np.float32),
        np.sort(rng.uniform(0, 300, count).astype(np.float32))[::-1],
        rows.astype(np.float32),
        size,
        nms_radius=4.0,
        sizes=rng.choice(np.float32([9, 18, 36]), count),
        angles=angles.astype(np.float32),
        record={"model": "m.onnx", "settings": {"scales": [0.5, 1.0]}},
    )
