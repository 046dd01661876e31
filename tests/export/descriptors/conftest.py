"""Cells to fit a projection to, and photographs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers import textured


@pytest.fixture
def cells() -> np.ndarray:
    """(3000, 10) correlated, far from the origin; no two variances are close."""
    rng = np.random.default_rng(3)
    mixed = rng.standard_normal((3000, 10)) * 0.6 ** np.arange(10) @ np.linalg.qr(rng.standard_normal((10, 10)))[0]
    return mixed + rng.uniform(-20, 20, 10)


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    folder = tmp_path / "photographs"
    folder.mkdir()
    for seed in range(3):
        cv2.imwrite(str(folder / f"{seed}.png"), textured(60, 80, seed))
    return folder
