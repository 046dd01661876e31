"""Squares of one image, aligned with another image by affine maps: least-squares matching."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]

UPRIGHT: Array = np.eye(2, dtype=np.float32)
_MOST_STEPS = 15
_SETTLED = 0.01  # pixels: a search whose step is shorter has ended
# Of patches of unit contrast.  The first damps the steps, but where they end is the same.  The second is what it costs,
# in squared differences, that the other image's shape moves the square's edge by a pixel from that of the start.
_DAMPING = 1e-4
_STIFFNESS = 1e-3


class Squares:
    """The squares around K points of an image, to be found in another.

    The offset o from a point lies at ``place + shape @ o`` in the other image: two numbers of the place, four of the
    2x2 shape.  Patches are compared less the plane that fits their pixels and at unit contrast, so light does not
    matter.

    The six are sought by Gauss-Newton steps for the least squared difference (Gruen, "Adaptive least squares
    correlation", South African Journal of Photogrammetry, 1985), taken in the first image, whose slopes are computed
    once: the inverse compositional algorithm of Baker and Matthews ("Lucas-Kanade 20 years on", IJCV 2004).  A shape
    that differs from the start's costs something: where the images say little of it, as on straight edges or where
    one of them is blurred, it stays.

    Parameters
    ----------
    image : (H, W) float32
    points : (K, 2) float32
        (x, y) in pixels; beyond the image its edge goes on.
    window : int
        Odd: the squares' side in pixels.
    """

    def __init__(self, image: Array, points: Array, window: int) -> None:
        half, side = window // 2, window + 2  # a pixel more all around, for the slopes
        square = _sampled(image, points, UPRIGHT[None], _offsets(side)).reshape(-1, side, side)
        self._offsets = _offsets(window)
        ramps = np.vstack([np.ones_like(self._offsets[:1]), self._offsets])
        self._ramps = (ramps / np.linalg.norm(ramps, axis=1, keepdims=True)).T
        self._patches, contrast = self._normalized(square[:, 1:-1, 1:-1].reshape(len(points), -1))
        slopes = square[:, 1:-1, 2:] - square[:, 1:-1, :-2], square[:, 2:, 1:-1] - square[:, :-2, 1:-1]
        dx, dy = (slope.reshape(len(points), -1) / (2 * contrast) for slope in slopes)
        x, y = self._offsets / half  # a shape by how far it moves the square's edge: all six are pixels
        changes = np.stack([dx, dy, dx * x, dx * y, dy * x, dy * y], axis=1)
        # What another brightness or contrast would change as well tells nothing.
        changes -= changes @ self._ramps @ self._ramps.T
        changes -= (changes @ self._patches[:, :, None]) * self._patches[:, None]
        normal = (changes @ changes.transpose(0, 2, 1)).astype(np.float64) + np.diag([_DAMPING] * 2 + [_STIFFNESS] * 4)
        inverse = np.linalg.inv(normal).astype(np.float32)
        self._steps = inverse @ changes  # (K, 6, P)
        self._springs = half * np.float32(_STIFFNESS) * inverse[:, :, 2:]  # (K, 6, 4)
        for each in (self._steps, self._springs):
            each[:, 2:] /= half

    def correlation(self, image: Array, places: Array, shapes: Array) -> Array:
        """Normalised cross-correlation, (K,) in [-1, 1], with `image` at (K, 2) places under (K, 2, 2) shapes."""
        seen, _ = self._normalized(_sampled(image, places, shapes, self._offsets))
        return np.asarray(np.einsum("kp,kp->k", seen, self._patches))

    def aligned(self, image: Array, places: Array, shapes: Array) -> tuple[Array, Array]:
        """The (K, 2) places and (K, 2, 2) shapes in `image` that a search finds which starts at these.

        They are NaN or infinite where it leads nowhere.
        """
        start, places, shapes = _inverse(shapes), places.copy(), shapes.copy()
        going = np.arange(len(places))
        for _ in range(_MOST_STEPS):
            if not len(going):
                break
            seen, _ = self._normalized(_sampled(image, places[going], shapes[going], self._offsets))
            with np.errstate(over="ignore", invalid="ignore"):
                strain = (start[going] @ shapes[going] - UPRIGHT).reshape(-1, 4)
                change = self._steps[going] @ (seen - self._patches[going])[:, :, None]
                change = (change + self._springs[going] @ strain[:, :, None])[:, :, 0]
                # By how the first image's square would have to change; its inverse goes before the map so far.
                shapes[going] = shapes[going] @ _inverse(UPRIGHT + change[:, 2:].reshape(-1, 2, 2))
                step = (shapes[going] @ change[:, :2, None])[:, :, 0]
                places[going] -= step
                going = going[np.linalg.norm(step, axis=1) > _SETTLED]
        return places, shapes

    def _normalized(self, patches: Array) -> tuple[Array, Array]:
        """The (K, P) patches less their planes, of unit length, and the (K, 1) lengths; a flat one is 0."""
        centred = patches - patches.mean(axis=1, keepdims=True)
        # Row by row, so that a result does not depend on which others are computed with it.
        rest = centred - (centred[:, None] @ self._ramps @ self._ramps.T)[:, 0]
        length = np.maximum(np.linalg.norm(rest, axis=1, keepdims=True), np.float32(1e-3))
        return rest / length, length


def _offsets(side: int) -> Array:
    """(2, side * side): x and y from the middle of a square, row by row."""
    offset = np.arange(side, dtype=np.float32) - np.float32((side - 1) / 2)
    return np.stack([np.tile(offset, side), np.repeat(offset, side)])


def _sampled(image: Array, places: Array, shapes: Array, offsets: Array) -> Array:
    """(K, P): the pixels at ``place + shape @ offset``, interpolated; beyond the image its edge goes on."""
    with np.errstate(over="ignore", invalid="ignore"):
        at = places[:, :, None] + shapes @ offsets
    return np.asarray(cv2.remap(image, at[:, 0], at[:, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _inverse(shapes: Array) -> Array:
    """Of (K, 2, 2) maps; infinite or NaN where there is none."""
    (a, b), (c, d) = shapes.transpose(1, 2, 0)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        return np.asarray(np.stack([d, -b, -c, a], axis=1) / (a * d - b * c)[:, None]).reshape(-1, 2, 2)
