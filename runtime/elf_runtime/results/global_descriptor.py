"""One descriptor of a whole image, pooled from its keypoints' descriptors, and which images are alike by it."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError
from elf_runtime.values import is_int

from .features import Array, Features
from .matching import as_rows

_EXPONENT = 0.25
_WIDEST = 128  # values of a descriptor; of wider ones as many random directions


def global_descriptor(features: Features | npt.NDArray[np.number]) -> Array:
    """The pooled descriptor of an image, for the choice of images that may show the same: see `nearest`.

    Second-order pooling: with the covariance C = U diag(s) U^T of the N descriptors, what stands on and above the
    diagonal of

        C^(1/4) = U diag(s^(1/4)) U^T,

    the other places times sqrt(2), at unit length.  So the product of two such rows is the cosine between the two
    matrices.  The root weakens what repeats in the image (Lin, Maji, "Improved bilinear pooling with CNNs", BMVC 2017;
    Jegou, Chum, "Negative evidences and co-occurrences in image retrieval", ECCV 2012).  Neither the places of the
    keypoints nor the network are needed: features from files give the same.

    Parameters
    ----------
    features : Features, or (N, D) descriptors
        Of more than 128 values, they are first projected onto 128 orthogonal directions, which are random and always
        the same.

    Returns
    -------
    (D (D + 1) / 2,) float32
        8256 values for 128.  Zeros where there are fewer than two keypoints, or all of one descriptor.

    Raises
    ------
    SettingError
        On descriptors that are no (N, D) numbers, or NaN, or have no values.
    """
    rows = as_rows(features, "only").astype(np.float64)
    if rows.shape[1] == 0:
        raise SettingError("these features have no descriptors to pool: the model was exported with --desc none")
    if rows.shape[1] > _WIDEST:
        rows = _product(rows, _directions(rows.shape[1]))
    upper = np.triu_indices(rows.shape[1])
    if len(rows) < 2:
        return np.zeros(len(upper[0]), np.float32)
    rows -= rows.mean(axis=0)
    spread, axes = np.linalg.eigh(_product(rows.T, rows) / len(rows))
    # What rounding leaves of a zero has a root that is not small.
    root = np.where(spread > 1e-9 * spread[-1], np.maximum(spread, 0.0), 0.0) ** _EXPONENT
    pooled = _product(axes * root, axes.T)[upper] * np.where(upper[0] == upper[1], 1.0, np.sqrt(2.0))
    return np.asarray(pooled / max(float(np.linalg.norm(pooled)), np.finfo(np.float64).tiny), np.float32)


@lru_cache(maxsize=4)
def _directions(width: int) -> npt.NDArray[np.float64]:
    """(width, 128) orthogonal directions."""
    return np.asarray(np.linalg.qr(np.random.default_rng(0).standard_normal((width, _WIDEST)))[0])


def _product(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """a b, on one thread, for those of NumPy go on waiting for more, in the way of the network of the next image."""
    return np.asarray(cv2.gemm(np.ascontiguousarray(a), np.ascontiguousarray(b), 1.0, None, 0.0))


def nearest_pairs(pooled: npt.NDArray[np.floating], count: int) -> list[tuple[int, int]]:
    """The pairs, in order, of each image with its `nearest`; one that both choose comes once, the lower index first."""
    near = enumerate(nearest(pooled, count))
    return sorted({(min(i, j), max(i, j)) for i, row in near for j in row.tolist()})


def nearest(pooled: npt.NDArray[np.floating], count: int) -> list[npt.NDArray[np.int64]]:
    """For each image the others that are most like it, the likest first.

    Their likeness is the cosine between global descriptors from which the mean over all images is taken: what all of
    them have in common tells none apart.

    Parameters
    ----------
    pooled : (I, G)
        `global_descriptor` of each image.
    count : int
        How many, from 1 on; fewer where there are no more.

    Returns
    -------
    list of (min(count, I - 1),) int64
        Equally like ones by their index.

    Raises
    ------
    SettingError
        If `count` is not such a number.
    """
    if not is_int(count) or count < 1:
        raise SettingError(f"how many images are nearest is an integer from 1 on, not {count!r}")
    rows = np.asarray(pooled, np.float32)
    rows = rows - rows.mean(axis=0, dtype=np.float64).astype(np.float32)
    rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    found = []
    for index, row in enumerate(rows):
        likeness = rows @ row
        likeness[index] = -np.inf
        found.append(np.argsort(-likeness, kind="stable")[: min(count, len(rows) - 1)])
    return found
