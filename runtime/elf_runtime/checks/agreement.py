"""Whether two ways to run a model (a provider, a precision, another file) find the same keypoints."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import SettingError
from elf_runtime.image.file import ImageLike
from elf_runtime.results.features import Features

SAME, NEAR = 0.5, 1.0  # pixels of the source image
ENOUGH = 0.9  # of the keypoints; float32 is above 0.99 on every provider that computes what the graph says


@dataclass(frozen=True)
class KeypointAgreement:
    """How far the keypoints of one run are those of a reference run on the same image.

    Attributes
    ----------
    reference, found : int
        Numbers of keypoints.
    same, near : float
        Keypoints that are each other's nearest, within 0.5 and within 1 pixel of the source image, as a share of
        the larger number; 1 where neither run has any.
    cosine, least_cosine : float, optional
        Median and minimum of the cosine between the descriptors of the near ones; None where there are none.
    """

    reference: int
    found: int
    same: float
    near: float
    cosine: float | None = None
    least_cosine: float | None = None

    @property
    def sufficient(self) -> bool:
        """Whether at least 90 % of the keypoints are near."""
        return self.near >= ENOUGH


def agreement(reference: Features, found: Features) -> KeypointAgreement:
    """Hold `found` against `reference`.

    Raises
    ------
    SettingError
        If they belong to images of different sizes.
    """
    if reference.image_size != found.image_size:
        raise SettingError(f"features of images of {reference.image_size} and {found.image_size} pixels")
    a, b = reference.keypoints.astype(np.float64), found.keypoints.astype(np.float64)
    larger = max(len(a), len(b))
    if not (len(a) and len(b)):
        share = 0.0 if larger else 1.0
        return KeypointAgreement(len(a), len(b), share, share)
    distance = np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=2))  # (N, M)
    to_b, to_a = distance.argmin(axis=1), distance.argmin(axis=0)
    index = np.flatnonzero(to_a[to_b] == np.arange(len(a)))
    apart = distance[index, to_b[index]]
    near = index[apart <= NEAR]
    same, close = float((apart <= SAME).sum() / larger), float(len(near) / larger)
    if len(near) == 0 or reference.descriptors.shape[1] == 0:
        return KeypointAgreement(len(a), len(b), same, close)
    cosines = (reference.descriptors[near] * found.descriptors[to_b[near]]).sum(axis=1)
    return KeypointAgreement(len(a), len(b), same, close, float(np.median(cosines)), float(cosines.min()))


def compare(reference: ElfRuntime, other: ElfRuntime, image: ImageLike | None = None) -> KeypointAgreement:
    """Detect with both on `image`, by default `pattern`.

    Raises
    ------
    ElfError
        If one of them can't run it.
    """
    pixels = pattern() if image is None else image
    return agreement(reference.detect(pixels), other.detect(pixels))


def pattern(height: int = 240, width: int = 320) -> npt.NDArray[np.uint8]:
    """A picture with blobs and edges of several sizes, always the same one.

    Returns
    -------
    (height, width, 3) uint8
    """
    rng = np.random.default_rng(0)
    total = np.zeros((height, width, 3), np.float32)
    for step in (5, 11, 23):
        coarse = rng.standard_normal((height // step + 2, width // step + 2, 3)).astype(np.float32)
        method = cv2.INTER_NEAREST if step == 23 else cv2.INTER_CUBIC  # squares have edges and corners
        total += cv2.resize(coarse, (width, height), interpolation=method) * np.float32(step**0.5)
    low, high = float(total.min()), float(total.max())
    return np.round((total - low) * (255.0 / (high - low))).astype(np.uint8)
