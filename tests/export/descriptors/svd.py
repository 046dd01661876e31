"""The reference of a fit: the scores by an SVD of the cells."""

from __future__ import annotations

import numpy as np


def by_svd(cells: np.ndarray, dim: int, whiten: float) -> tuple[np.ndarray, np.ndarray]:
    """Variances and whitened scores (n, dim) of the centred cells, without a covariance matrix."""
    centred = cells - cells.mean(axis=0)
    u, s, _ = np.linalg.svd(centred, full_matrices=False)
    variance = s[:dim] ** 2 / (len(cells) - 1)
    return variance, u[:, :dim] * s[:dim] * (variance / variance[0]) ** (-whiten / 2)
