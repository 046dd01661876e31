"""Synthetic views: the same bits everywhere, and what OpenCV makes."""

from __future__ import annotations

import hashlib

import cv2
import numpy as np
import pytest

from elf_eval.data.images import ImageRef
from elf_eval.data.views import RandomHomography, Rotation, Zoom, homography_through, warp_image


def gradient_image():
    """Integer arithmetic only: the same on every machine."""
    y, x = np.mgrid[0:48, 0:64]
    return np.stack([(3 * x + y) % 256, (x * y) % 256, (x + 5 * y) % 256], axis=2).astype(np.uint8)


@pytest.mark.parametrize(
    ("view", "digest"),
    [
        (Rotation(40), "4af6e3109bef5fc1"),
        (Zoom(1.75), "a0b539690449c564"),
        (RandomHomography(3, 0.2), "602cd8799f2ffbfb"),
    ],
)
def test_views_are_the_same_bits_everywhere(view, digest):
    seen = warp_image(gradient_image(), view.matrix((64, 48)))
    assert hashlib.sha256(seen.tobytes()).hexdigest()[:16] == digest


def test_warp_image_against_opencv(photo_file):
    pixels = ImageRef("photo", photo_file).open(None).pixels
    matrix = RandomHomography(1, 0.2).matrix((pixels.shape[1], pixels.shape[0]))
    mine = warp_image(pixels, matrix).astype(int)
    theirs = cv2.warpPerspective(pixels, matrix, (pixels.shape[1], pixels.shape[0])).astype(int)
    both = (mine > 0).all(axis=2) & (theirs > 0).all(axis=2)
    assert both.mean() > 0.5
    # OpenCV's warp rounds coordinates to 1/32 of a pixel.
    assert np.abs(mine - theirs)[both].mean() < 2


def test_homography_through_four_points(rng):
    source, target = rng.uniform(0, 100, (4, 2)), rng.uniform(0, 100, (4, 2))
    q = np.column_stack([source, np.ones(4)]) @ homography_through(source, target).T
    assert q[:, :2] / q[:, 2:] == pytest.approx(target, abs=1e-6)
