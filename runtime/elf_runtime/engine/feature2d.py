"""`ElfFeature2D`: ELF with the methods of OpenCV's detectors, for code that was written for `cv2.SIFT`."""

from __future__ import annotations

import os
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ImageError, SettingError
from elf_runtime.results.features import Features
from elf_runtime.results.quantization import quantized
from elf_runtime.values import is_int

from .runtime import ElfRuntime

KeyPoints = tuple[Any, ...]


class ElfFeature2D:
    """ELF in the place of a ``cv2.Feature2D``: the same methods, orders of arguments and results.

    Images and masks may be arrays or ``cv2.UMat``, which gives descriptors as one; images are BGR or grey, as OpenCV
    reads them, or paths of files, as for `ElfRuntime`.  In arrays smaller than the model takes, empty ones and None
    there is nothing to find; what is no image is an ImageError.  A mask is non-zero where keypoints may be, in any of
    its channels where it has several.  `detect` and `compute` take a list of images, too.

    >>> detector = ElfFeature2D(max_keypoints=2000)
    >>> keypoints, descriptors = detector.detectAndCompute(image, None)      # doctest: +SKIP
    """

    def __init__(
        self,
        model: str | os.PathLike[str] | bytes | ElfRuntime | None = None,
        *,
        preset: str | None = None,
        descriptor: str | None = None,
        descriptor_type: str = "float32",
        color: str = "bgr",
        **settings: Any,
    ) -> None:
        """Open a model, with settings for all images.

        Parameters
        ----------
        model : path, bytes or ElfRuntime, optional
            As for `ElfRuntime`; an instance where providers or threads are to be chosen.
        preset, descriptor, **settings
            As for `ElfRuntime.detect`: ``max_keypoints=2000``, ``oriented=True`` ...
        color : "bgr" or "rgb"
            Order of the channels of arrays, as for `ElfRuntime`, whose own it is where one is given.
        descriptor_type : "float32" or "uint8"
            uint8 is that of `Features.quantized`: a quarter of the memory, compared by the same norm.

        Raises
        ------
        ModelError, SettingError
            As `ElfRuntime`, and on settings that it refuses.
        """
        if descriptor_type not in ("float32", "uint8"):
            raise SettingError(f"descriptor_type is 'float32' or 'uint8', not {descriptor_type!r}")
        if is_int(model):
            raise SettingError(f"the first argument is a model; the number of keypoints is max_keypoints={model!r}")
        self._bytes = descriptor_type == "uint8"
        self.runtime = model if isinstance(model, ElfRuntime) else ElfRuntime(model, color=color)
        self._given = {"preset": preset, "descriptor": descriptor, **settings}
        self._params = self.runtime.params(preset, **settings)
        self._descriptor, self._spec = descriptor, self.runtime.contract.descriptor(descriptor)

    def detect(self, image: Any, mask: Any = None) -> KeyPoints:
        """cv2.KeyPoint of the image, the strongest first; a tuple of such for a list of images (and masks)."""
        if isinstance(image, (list, tuple)):
            masks = [None] * len(image) if mask is None else mask
            if len(masks) != len(image):
                raise ImageError(f"{len(masks)} masks for {len(image)} images")
            return tuple(self.detect(one, its) for one, its in zip(image, masks, strict=True))
        return tuple(self._features(image, mask).to_cv2()[0])

    def compute(self, image: Any, keypoints: Any, descriptors: Any = None) -> tuple[KeyPoints, Any]:
        """The keypoints, all of them, and their descriptors, (N, D) of the type; None where there are no keypoints.

        For lists of images and of their keypoints: two tuples.  `descriptors` is not written to.
        """
        if isinstance(image, (list, tuple)):
            if len(keypoints) != len(image):
                raise ImageError(f"{len(keypoints)} lists of keypoints for {len(image)} images")
            found = [self.compute(one, its) for one, its in zip(image, keypoints, strict=True)]
            return tuple(points for points, _ in found), tuple(rows for _, rows in found)
        points = tuple(keypoints)
        if not points:
            return points, None
        rows = self.runtime.describe(_array(image), points, self._descriptor, params=self._params)
        return points, _like(quantized(rows) if self._bytes else rows, image)

    def detectAndCompute(
        self, image: Any, mask: Any, descriptors: Any = None, useProvidedKeypoints: bool = False
    ) -> tuple[KeyPoints, npt.NDArray[Any] | None]:
        """Keypoints and their descriptors, (N, D) of the type; ``((), None)`` where there is nothing to find.

        `descriptors` is not written to.

        Raises
        ------
        SettingError
            With `useProvidedKeypoints`: Python has no way to give them here; `compute` takes keypoints.
        """
        if useProvidedKeypoints:
            raise SettingError("useProvidedKeypoints: compute(image, keypoints) describes keypoints that you have")
        keypoints, rows = self._features(image, mask).to_cv2()
        return tuple(keypoints), _like(rows, image) if keypoints else None

    def defaultNorm(self) -> int:
        """cv2.NORM_L2: how descriptors are compared."""
        return int(cv2.NORM_L2)

    def descriptorSize(self) -> int:
        """Values of a descriptor; 0 for a model without."""
        return 0 if self._spec is None else self._spec.dim

    def descriptorType(self) -> int:
        """cv2.CV_32F, or cv2.CV_8U where `descriptor_type` is "uint8"."""
        return int(cv2.CV_8U if self._bytes else cv2.CV_32F)

    def getDefaultName(self) -> str:
        """The name that OpenCV's FileStorage would have for it."""
        return "Feature2D.ELF"

    def empty(self) -> bool:
        """False: it is ready."""
        return False

    def _features(self, image: Any, mask: Any) -> Features:
        pixels = _array(image)
        if _is_too_small(pixels, self.runtime.contract.input.min_size):  # OpenCV's detectors find nothing there
            return Features.from_cv2((), None, (1, 1))
        found = self.runtime.detect(pixels, mask=_mask(mask), descriptor=self._descriptor, params=self._params)
        return found.quantized() if self._bytes else found

    def __repr__(self) -> str:
        given = "".join(f", {name}={value!r}" for name, value in self._given.items() if value is not None)
        return f"ElfFeature2D({self.runtime!r}{given}{', uint8 descriptors' if self._bytes else ''})"


def _array(image: Any) -> Any:
    return image.get() if isinstance(image, cv2.UMat) else image


def _is_too_small(pixels: Any, least: int) -> bool:
    """Whether it is an image, or the nothing that `cv2.imread` gives, and smaller than the model takes."""
    if pixels is None:
        return True
    if not (hasattr(pixels, "__array__") or hasattr(pixels, "__array_interface__")):
        return False  # a path, or what is refused
    shape = np.shape(pixels)
    return 0 in shape or (len(shape) in (2, 3) and min(shape[:2]) < least)


def _like(rows: Any, image: Any) -> Any:
    """A cv2.UMat for one, as OpenCV's detectors give it."""
    return cv2.UMat(rows) if isinstance(image, cv2.UMat) else rows


def _mask(mask: Any) -> npt.NDArray[Any] | None:
    """(H, W): non-zero in any channel."""
    if mask is None:
        return None
    array = np.asarray(_array(mask))
    return (array != 0).any(axis=2) if array.ndim == 3 else array
