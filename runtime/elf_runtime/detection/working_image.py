"""The image that the network sees: at the working size, with the way back to the source and where keypoints may be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from elf_runtime.contract import InputSpec, ModelContract
from elf_runtime.errors import ImageError, SettingError
from elf_runtime.image import convert as images
from elf_runtime.image import masks
from elf_runtime.params import DetectionParams
from elf_runtime.results.features import window_size

from .contrast import window_for
from .scaling import Array, Scaling


@dataclass(frozen=True)
class WorkingImage:
    """An image made ready for a model.

    Attributes
    ----------
    pixels : (h, w, C) float32
        As the graph takes them.
    scaling : Scaling
    mask : (H, W) bool, optional
        Where in the source image keypoints may be, if not everywhere.
    textured : bool
        False where all pixels are the same: there is no saliency to compute.
    window : int
        Side of the window that contrast is measured in, in working pixels.
    gray_levels : float
        Of 255, per unit of the pixels.
    """

    pixels: Array
    scaling: Scaling
    mask: npt.NDArray[np.bool_] | None
    textured: bool
    window: int
    gray_levels: float

    def allowed(self) -> npt.NDArray[np.bool_] | None:
        """(h, w): where the mask has the source pixel of a working pixel's centre; None without a mask."""
        if self.mask is None:
            return None
        h, w = self.scaling.working
        columns, rows = self.scaling.source_pixels(np.stack([np.arange(max(h, w))] * 2, axis=1)).T
        return np.asarray(self.mask[rows[:h, None], columns[:w]])

    def kept_inside(self, refined: Array, found: npt.NDArray[np.number], border: int) -> Array:
        """The refined points, those that would leave what border and mask allow back where they were found.

        Parameters
        ----------
        refined, found : (N, 2), (x, y) in working pixels
        border : int
            In source pixels; 0 holds none back.
        """
        stays = np.ones(len(found), np.bool_)
        if border:
            height, width = self.scaling.source
            first = min(border, max(height, width))
            source = self.scaling.to_source(refined)
            stays &= ((source >= first) & (source <= (width - 1 - first, height - 1 - first))).all(axis=1)
        if self.mask is not None:
            columns, rows = self.scaling.source_pixels(refined).T
            stays &= self.mask[rows, columns]
        return np.where(stays[:, None], refined, found.astype(np.float32))


Levels: TypeAlias = tuple[WorkingImage, ...]
"""An image at every working scale, the finest first: all `textured`, or none."""


def prepare(
    image: npt.NDArray[Any], params: DetectionParams, mask: npt.ArrayLike | None, contract: ModelContract, model: str
) -> Levels:
    """The image at each working size, as a model takes it, and where keypoints may be.

    That is where the mask, if there is one, is not zero, nor the image's alpha, and not near the edge of that.
    Every level is resized from the image itself.  Scales that come to the same size, as those of a small image may, are
    one level.

    Parameters
    ----------
    image : array, as `image.read` gives it
    mask : (H, W), optional
    model : str
        The model's name for messages.

    Raises
    ------
    ImageError
        On an image that is too small, or an image or mask that can't be processed.
    SettingError
        On a working scale, `max_side` or oriented keypoints, where the model takes one size only.
    """
    if params.oriented and contract.input.is_fixed:
        raise SettingError(f"{model} takes images of one size only, and not the patches of oriented keypoints")
    if not isinstance(params.max_side, str):
        if contract.input.is_fixed:
            raise SettingError(f"{model} takes images of one size only: max_side can't be chosen")
        if params.max_side < contract.input.min_size:
            raise SettingError(
                f"max_side is {params.max_side}, and {model} sees {contract.input.min_size} pixels or more"
            )
    # One pixel stands for an image of one colour, which may be a gigabyte that was a kilobyte of file.
    blank = images.is_blank(image)
    pixels = images.to_pixels(image[:1, :1] if blank else image, contract.input)
    size = (image.shape[0], image.shape[1])
    by_size: dict[tuple[int, int], Scaling] = {}
    for scale in params.scales_for(size):
        scaling = _scaling(size, scale, contract.input, model)
        by_size.setdefault(scaling.working, scaling)
    textured = not (blank or images.is_flat(pixels))
    allowed = masks.seen(image, mask)
    gray_levels = 255.0 / contract.input.value_range * images.unused_range(image)

    def level(scaling: Scaling) -> WorkingImage:
        seen = np.tile(pixels, (*scaling.working, 1)) if blank else images.resized(pixels, scaling.working)
        border = _mask_border(params, contract.receptive_field, scaling.scale)
        inside = None if allowed is None else masks.shrunk(allowed, border)
        window = window_for(contract.receptive_field, scaling.working)
        return WorkingImage(seen, scaling, inside, textured, window, gray_levels)

    return tuple(level(scaling) for scaling in by_size.values())


def nearest_level(sizes: npt.ArrayLike, levels: Levels, nms_radius: int) -> npt.NDArray[np.int64]:
    """The number of the level, (N,), whose keypoints have the size nearest, by ratio, to each of `sizes`, (N,)."""
    given = np.maximum(np.asarray(sizes, np.float64), np.finfo(np.float32).tiny)
    return np.asarray(np.abs(np.log(given[:, None] / window_sizes(levels, nms_radius))).argmin(axis=1))


def window_sizes(levels: Levels, nms_radius: int) -> npt.NDArray[np.float64]:
    """The size, in source pixels, that each level's own keypoints have: see `Features.sizes`."""
    scales = np.array([image.scaling.scale for image in levels])
    return np.asarray(window_size(nms_radius, levels[0].scaling.source) * scales[0] / scales, np.float64)


def check_least(size: tuple[int, int], spec: InputSpec) -> None:
    """Raise ImageError on an image (height, width) that is too small for the model."""
    if min(size) < spec.min_size:
        raise ImageError(f"the image has {size[1]}x{size[0]} pixels; the smallest is {spec.min_size}x{spec.min_size}")


def _scaling(size: tuple[int, int], scale: float, spec: InputSpec, model: str) -> Scaling:
    """From (height, width) to the size that the model is fed: a small image is seen at a larger scale."""
    height, width = size
    check_least(size, spec)
    if spec.is_fixed and scale != 1.0:
        raise SettingError(
            f"{model} takes images of {spec.width or 'any'}x{spec.height or 'any'} (width x height) only and "
            f"resizes to that: scale {scale:g} can't be chosen"
        )
    if scale < 1.0:
        scale = max(scale, spec.min_size / min(size))
    h, w = spec.size_for(height, width, scale)
    return Scaling(size, (h, w), math.sqrt(h / height * w / width) if spec.is_fixed else scale)


def _mask_border(params: DetectionParams, receptive_field: float, scale: float) -> int:
    """How many source pixels keypoints keep away from a mask's edge: see `DetectionParams.mask_border`."""
    if not isinstance(params.mask_border, str):
        return params.mask_border
    if not receptive_field:
        return params.border
    return math.ceil((receptive_field - 1 + params.denoise[0] - 1) / 2 / scale)
