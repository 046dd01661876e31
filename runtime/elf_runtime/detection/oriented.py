"""Oriented keypoints: each with the size and the orientation of what lies under it, and described at that size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .descriptors import Array
from .upright import WIDEST, UprightPatches
from .working_image import Levels, nearest_level, window_sizes


@dataclass(frozen=True)
class Oriented:
    """What gives keypoints of an image their sizes, orientations and descriptors.

    Attributes
    ----------
    images : Levels
    patches : of the image at each working scale
    nms_radius : int
        In source pixels; it sets the unit of sizes, as `Features.sizes` says.
    """

    images: Levels
    patches: Sequence[UprightPatches]
    nms_radius: int

    def sizes(self, number: int, points: Array) -> Array:
        """(N,): the sizes, in source pixels, of what lies under working pixels (x, y) of a level."""
        own = window_sizes(self.images, self.nms_radius)[number]
        return np.asarray(own * 2 ** self.patches[number].blobs.octaves(points), np.float32)

    def centres(self, number: int, points: Array, border: int) -> Array:
        """(N, 2): the centres of what lies under working pixels (x, y) of a level, where border and mask allow them."""
        blobs = self.patches[number].blobs
        return self.images[number].kept_inside(blobs.centres(points, blobs.octaves(points)), points, border)

    def described(self, places: Array, sizes: Array, angles: Array) -> tuple[Array, Array]:
        """Angles, (N,), and descriptors, (N, D), of places in the source image, (N, 2) as (x, y).

        Each is described at the working scale whose keypoints have the size nearest to its own, by ratio, and there by
        a patch that is wider or narrower by what is left of that ratio, up to a factor of `WIDEST`.

        Parameters
        ----------
        sizes : (N,)
            In source pixels.
        angles : (N,)
            In degrees; one below 0 is found here.
        """
        level = nearest_level(sizes, self.images, self.nms_radius)
        zooms = np.clip(sizes / window_sizes(self.images, self.nms_radius)[level], 1 / WIDEST, WIDEST)
        turned = np.array(angles, np.float32)
        descriptors = np.zeros((len(places), self.patches[0].dim), np.float32)
        for number in np.unique(level):
            own, patches = level == number, self.patches[number]
            points = self.images[number].scaling.to_working(places[own])
            lost = turned[own] < 0
            if lost.any():
                turned[np.flatnonzero(own)[lost]] = patches.angles(points[lost], zooms[own][lost])
            descriptors[own] = patches.at(points, turned[own], zooms[own])
        return turned, descriptors
