"""Descriptors of upright patches: what is around each keypoint, turned by its orientation and brought to one size.

The network sees the patches of many keypoints at once, side by side in an image, a sheet.  A patch is about as wide as
what a cell of the descriptor map sees, so that its neighbours hardly matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec, InputSpec
from elf_runtime.image.convert import resized

from .descriptors import Array, DescriptorMap
from .orientation import orientations
from .scale_space import OCTAVES, ScaleSpace

Wide = npt.NDArray[np.float64]

LEAST_PATCH = 32  # pixels
_CELLS = 8  # of the descriptor map along a patch: what a cell of the bundled model's sees
_SHEET = 256  # pixels: the side of a sheet
WIDEST = 2.0**OCTAVES  # zoom of a patch


@dataclass(frozen=True)
class Sheet:
    """How patches lie in an image of one size for a model.

    Attributes
    ----------
    patch : int
        Side of a patch, in pixels.
    size : (height, width)
        Of the sheet, in pixels.
    centres : (K, 2) float32
        Where the keypoint of each patch lies, (x, y): at the centre of a cell of the descriptor map, the one nearest to
        the patch's own.
    """

    patch: int
    size: tuple[int, int]
    centres: Array

    @classmethod
    def of(cls, taken: InputSpec, spec: DescriptorSpec | None) -> Sheet:
        """The sheet for a model that takes any size, and a descriptor (None: of no cells)."""
        stride, offset = (spec.stride, spec.offset) if spec else (1.0, 0.0)
        patch = max(LEAST_PATCH, math.ceil(_CELLS * stride))
        side = max(_SHEET, patch, taken.min_size)
        side = -(-side // taken.multiple) * taken.multiple
        middle = (np.arange(side // patch) + 0.5) * patch - 0.5
        centre = offset + np.floor((middle - offset) / stride + 0.5) * stride
        x, y = np.meshgrid(centre, centre)
        return cls(patch, (side, side), np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32))

    def filled(self, pixels: Array, points: Array, angles: Array, zooms: Wide) -> Iterator[Array]:
        """Images of `size` with the patches around points, (N, 2): see `upright_patch`, with (N,) angles and zooms.

        Where there are fewer than would fill a sheet, its rest shows the whole image: many networks see an image
        relative to its mean and contrast, and so a descriptor does not depend on how many others there are.
        """
        ground = resized(pixels, self.size)
        height, width = pixels.shape[:2]
        inside = np.clip(points, 0, (width - 1, height - 1)).astype(np.float64)
        for start in range(0, len(points), len(self.centres)):
            sheet = ground.copy()
            part = slice(start, start + len(self.centres))
            own = zip(self.centres, inside[part], angles[part].tolist(), zooms[part].tolist(), strict=False)
            for centre, point, angle, zoom in own:
                left, top = (centre // self.patch).astype(np.int64) * self.patch
                tile = upright_patch(pixels, point, angle, centre - (left, top), self.patch, zoom)
                sheet[top : top + self.patch, left : left + self.patch] = tile
            yield sheet


def upright_patch(
    pixels: Array, point: Wide, angle: float, centre: npt.NDArray[np.floating], side: int, zoom: float = 1.0
) -> Array:
    """The (side, side, C) around a point, turned so that the direction `angle` points along x, mirrored at the border.

    With R the rotation by the angle, clockwise in the image, pixel q of the patch is the image at
    point + zoom R (q - centre), interpolated bilinearly.

    Parameters
    ----------
    pixels : (h, w, C) float32
    point, centre : (x, y)
        The same place, in the image and in the patch.
    angle : float
        In degrees.
    zoom : float
        Pixels of the image along one of the patch, at most `WIDEST`.
    """
    radians = math.radians(angle)
    turn = zoom * np.array([[math.cos(radians), -math.sin(radians)], [math.sin(radians), math.cos(radians)]])
    # OpenCV takes images of up to 32767 pixels only; nothing in the patch is as far away as this.
    reach = math.ceil(2 * WIDEST * side)
    x, y = np.maximum(point.astype(np.int64) - reach, 0)
    near = pixels[y : y + 2 * reach, x : x + 2 * reach]
    from_patch = np.column_stack([turn, point - (x, y) - turn @ centre])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    found = cv2.warpAffine(near, from_patch, (side, side), flags=flags, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(found, np.float32).reshape(side, side, -1)


@dataclass(frozen=True)
class UprightPatches:
    """What describes keypoints of an image, each turned upright.

    Attributes
    ----------
    pixels : (h, w, C) float32
        Of the working image.
    sheet : Sheet
    look : callable, optional
        From a sheet's pixels to its descriptor map; None for a model without one.
    dim : int
        Of a descriptor.
    """

    pixels: Array
    sheet: Sheet
    look: Callable[[Array], DescriptorMap] | None
    dim: int

    @cached_property
    def blobs(self) -> ScaleSpace:
        return ScaleSpace(self.pixels)

    def angles(self, points: Array, zooms: Wide) -> Array:
        """The orientations, (N,), at working pixels (x, y): of the gradients in an eighth of a patch around them."""
        sigmas = self.sheet.patch / 8 * zooms
        return orientations(self.pixels, points, np.rint(sigmas * 4) / 4)

    def at(self, points: Array, angles: Array, zooms: Wide) -> Array:
        """The descriptors, (N, D), at working pixels (x, y) of the patches of (N,) angles, in degrees, and zooms."""
        found = np.zeros((len(points), self.dim), np.float32)
        if self.look is not None:
            count = len(self.sheet.centres)
            for number, sheet in enumerate(self.sheet.filled(self.pixels, points, angles, zooms)):
                rows = found[number * count : (number + 1) * count]
                rows[...] = self.look(sheet).at(self.sheet.centres[: len(rows)])
        return found
