"""The image that the network sees: at the working size, with the way back to the source and where keypoints may be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.contract import InputSpec, ModelContract
from elf_runtime.errors import ImageError, SettingError
from elf_runtime.image import convert as images
from elf_runtime.image import masks
from elf_runtime.params import DetectionParams

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

    def kept_inside(self, refined: Array, found: npt.NDArray[np.int64], border: int) -> Array:
        """The refined points, those that would leave what border and mask allow back at their whole pixels.

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


def prepare(
    image: npt.NDArray[Any], params: DetectionParams, mask: npt.ArrayLike | None, contract: ModelContract, model: str
) -> WorkingImage:
    """The image at the working size, as a model takes it, and where keypoints may be.

    That is where the mask, if there is one, is not zero, nor the image's alpha, and not near the edge of that.

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
        On a working scale, where the model takes one size only.
    """
    # One pixel stands for an image of one colour, which may be a gigabyte that was a kilobyte of file.
    blank = images.is_blank(image)
    pixels = images.to_pixels(image[:1, :1] if blank else image, contract.input)
    scaling = _scaling((image.shape[0], image.shape[1]), params.scale, contract.input, model)
    textured = not (blank or images.is_flat(pixels))
    pixels = np.tile(pixels, (*scaling.working, 1)) if blank else images.resized(pixels, scaling.working)
    allowed = masks.seen(image, mask)
    if allowed is not None:
        allowed = masks.shrunk(allowed, _mask_border(params, contract.receptive_field, scaling.scale))
    window = window_for(contract.receptive_field, scaling.working)
    gray_levels = 255.0 / contract.input.value_range * images.unused_range(image)
    return WorkingImage(pixels, scaling, allowed, textured, window, gray_levels)


def _scaling(size: tuple[int, int], scale: float, spec: InputSpec, model: str) -> Scaling:
    """From (height, width) to the size that the model is fed: a small image is seen at a larger scale."""
    height, width = size
    if min(size) < spec.min_size:
        raise ImageError(f"the image has {width}x{height} pixels; the smallest is {spec.min_size}x{spec.min_size}")
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
