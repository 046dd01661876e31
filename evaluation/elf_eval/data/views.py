"""Synthetic views of an image by rotation, zoom or homography, with the same bits on every machine."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from elf_eval.coordinates import Float, Size, corners


class View(ABC):
    """A change of the working image, by a homography of its pixels."""

    @abstractmethod
    def matrix(self, size: Size) -> Float:
        """(3, 3): pixels of the working image -> pixels of the view, which has the same (width, height)."""


@dataclass(frozen=True)
class Rotation(View):
    """By `degrees` clockwise (y points down) about the image's centre, on the same canvas."""

    degrees: float

    def matrix(self, size: Size) -> Float:
        angle = np.radians(self.degrees)
        # Rounded, so that the last bit of a platform's cosine does not reach the pixels.
        c, s = round(float(np.cos(angle)), 12), round(float(np.sin(angle)), 12)
        return _about_centre(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), size)


@dataclass(frozen=True)
class Zoom(View):
    """By `factor` about the image's centre, on the same canvas; above 1 the borders go out of sight."""

    factor: float

    def matrix(self, size: Size) -> Float:
        return _about_centre(np.diag([self.factor, self.factor, 1.0]), size)


@dataclass(frozen=True)
class RandomHomography(View):
    """Every corner is moved by up to `strength` of the width and height; `seed` fixes how."""

    seed: int
    strength: float

    def matrix(self, size: Size) -> Float:
        shift = np.random.default_rng(self.seed).uniform(-self.strength, self.strength, (4, 2))
        source = corners(size)
        target = source + shift * np.asarray(size, np.float64)
        # Rounded, since a linear solver's last bits differ between libraries; what is rounded is the truth.
        return np.round(homography_through(source, target), 6)


def _about_centre(matrix: Float, size: Size) -> Float:
    x, y = (size[0] - 1) / 2.0, (size[1] - 1) / 2.0
    to = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])
    back = np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
    return np.asarray(back @ matrix @ to)


def homography_through(source: Float, target: Float) -> Float:
    """The (3, 3) homography with [2, 2] = 1 that maps four (4, 2) points to four others.

    Each pair gives two linear equations in the eight unknowns:
    x' (h7 x + h8 y + 1) = h1 x + h2 y + h3,   y' (h7 x + h8 y + 1) = h4 x + h5 y + h6.
    """
    rows, right = [], []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        right += [u, v]
    return np.append(np.linalg.solve(np.array(rows), np.array(right)), 1.0).reshape(3, 3)


def _inverse(matrix: Float) -> Float:
    """By cofactors: rows' cross products over the determinant."""
    r0, r1, r2 = matrix
    columns = np.stack([np.cross(r1, r2), np.cross(r2, r0), np.cross(r0, r1)], axis=1)
    return np.asarray(columns / (r0 * columns[:, 0]).sum())


def warp_image(pixels: npt.NDArray[np.uint8], matrix: Float) -> npt.NDArray[np.uint8]:
    """`pixels` seen through a homography: bilinear, black where there is nothing to see.

    Computed in float64 by single IEEE operations and rounded once, half up.  So the bits do not depend on a library's
    fixed-point weights or vector instructions, and a derived dataset can be made again anywhere.

    Parameters
    ----------
    pixels : (H, W, C) uint8
    matrix : (3, 3)
        Pixels of the source -> pixels of the result, which has the same size.
    """
    height, width = pixels.shape[:2]
    y, x = (grid.ravel().astype(np.float64) for grid in np.mgrid[0:height, 0:width])
    a = _inverse(matrix)
    # Not a matrix product: BLAS fuses multiplication and addition on some machines and not on others.
    w = a[2, 0] * x + a[2, 1] * y + a[2, 2]
    w = np.where(w > 0.0, w, np.nan)
    px, py = (a[0, 0] * x + a[0, 1] * y + a[0, 2]) / w, (a[1, 0] * x + a[1, 1] * y + a[1, 2]) / w
    seen = (px >= 0.0) & (px <= width - 1.0) & (py >= 0.0) & (py <= height - 1.0)
    px, py = px[seen], py[seen]
    left = np.minimum(px.astype(np.int64), max(width - 2, 0))
    top = np.minimum(py.astype(np.int64), max(height - 2, 0))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fx, fy = (px - left)[:, None], (py - top)[:, None]
    upper = pixels[top, left] * (1.0 - fx) + pixels[top, right] * fx
    lower = pixels[bottom, left] * (1.0 - fx) + pixels[bottom, right] * fx
    out = np.zeros((height * width, pixels.shape[2]), np.uint8)
    out[seen] = np.floor(upper * (1.0 - fy) + lower * fy + 0.5).astype(np.uint8)
    return out.reshape(pixels.shape)
