"""The image that features came from: given by the caller, or read again by their record."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from elf_runtime.errors import ImageError, SettingError
from elf_runtime.image.convert import checked
from elf_runtime.image.file import COLORS, MAX_PIXELS, ImageFile, ImageLike, image_errors, read

if TYPE_CHECKING:
    from elf_runtime.results.features import Features


def pixels_of(image: ImageLike, features: Features, color: str = "bgr") -> npt.NDArray[Any]:
    """The pixels of the image of `features`: (H, W) or (H, W, 3), BGR, of uint8, uint16 or floats in [0, 1].

    Raises
    ------
    ImageError
        If it is no image, or of another size.
    SettingError
        If `features` are none, or `color` is another than "bgr" and "rgb".
    """
    if not hasattr(features, "image_size"):
        raise SettingError(f"features are of ElfRuntime.detect, not of {type(features).__name__}")
    if color not in COLORS:
        raise SettingError(f"color is 'bgr' or 'rgb', not {color!r}")
    pixels = read(image, max_pixels=max(MAX_PIXELS, features.image_size[0] * features.image_size[1]), color=color)
    with image_errors(image):
        pixels = checked(pixels)
        if pixels.shape[:2] != tuple(features.image_size):
            height, width = features.image_size
            raise ImageError(f"the image is {pixels.shape[1]}x{pixels.shape[0]}, that of the features {width}x{height}")
    return pixels


def recorded_pixels(features: Features) -> npt.NDArray[Any] | None:
    """`recorded_image` without its alpha."""
    pixels = recorded_image(features)
    return None if pixels is None else checked(pixels)


def recorded_image(features: Features) -> npt.NDArray[Any] | None:
    """The image of the file that the features' record names; None where it is not there, or no longer the same."""
    record = features.record or {}
    path, digest = record.get("image"), record.get("image_sha256")
    if not isinstance(path, str):
        return None
    try:
        file = ImageFile(path)
        if digest is not None and digest != file.sha256:
            return None
        pixels = file.decoded(record.get("ignore_exif") is True)
        checked(pixels)
    except ImageError:
        return None
    return pixels if pixels.shape[:2] == tuple(features.image_size) else None
