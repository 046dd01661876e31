"""Images that an export measures a network on: what a projection of descriptors is fitted to.

Without a folder of the user's these are twelve public-domain photographs that come with the exporter
(calibration_images/README.md), so that an export needs no network and gives the same file again.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime import InputSpec
from elf_runtime.errors import ImageError
from elf_runtime.image.convert import is_flat, resized, to_pixels
from elf_runtime.image.file import image_errors, read

from .errors import ExportError

Array = npt.NDArray[np.float32]

BUNDLED = Path(__file__).parent / "calibration_images"
ENDINGS = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")
MOST_IMAGES = 100
MOST_PIXELS = 640 * 480  # of one image, as the network sees it


@dataclass(frozen=True)
class CalibrationSet:
    """Images to measure a network on.

    Attributes
    ----------
    name : str
        For the contract.
    files : tuple of Path
        In the order of their names.
    sha256 : str
        Over the SHA-256 digests of the files, in that order.
    ready : bool
        The images have the size at which a network sees them: no working scale is applied.
    """

    name: str
    files: tuple[Path, ...]
    sha256: str
    ready: bool = False

    def __len__(self) -> int:
        return len(self.files)

    def batches(self, spec: InputSpec, scale: float = 1.0) -> Iterator[Array]:
        """What the graph is fed, one image at a time.

        Of an image with more than 640x480 pixels at the working scale only the central part is taken: memory
        stays bounded, and details keep the size that they have in use.

        Parameters
        ----------
        spec : InputSpec
            The graph's input.
        scale : float
            Working scale: 0.5 halves width and height, where the images are not `ready`.

        Yields
        ------
        (1, h, w, C) float32, raw pixels

        Raises
        ------
        ExportError
            If a file can't be read as an image any more.
        """
        for path in self.files:
            yield self._pixels(path, spec, 1.0 if self.ready else scale)[None]

    def _pixels(self, path: Path, spec: InputSpec, scale: float) -> Array:
        pixels = to_pixels(decoded(path), spec)
        height, width = pixels.shape[:2]
        if not spec.is_fixed:
            share = math.sqrt(MOST_PIXELS / (height * width * scale * scale))
            if share < 1.0:
                h, w = max(1, int(height * share)), max(1, int(width * share))
                top, left = (height - h) // 2, (width - w) // 2
                pixels = np.ascontiguousarray(pixels[top : top + h, left : left + w])
                height, width = h, w
            scale = max(scale, spec.min_size / min(height, width))
        return resized(pixels, spec.size_for(height, width, scale))


def decoded(path: Path) -> npt.NDArray[Any]:
    """The image in a file, as `ElfRuntime` reads it: BGR or grey, with its bit depth kept.

    Raises
    ------
    ExportError
        Naming the file, if it is no image, or none that the runtime takes.
    """
    try:
        image = read(path)
        with image_errors(path):
            to_pixels(image, InputSpec())
    except ImageError as error:
        raise ExportError(str(error)) from error
    return image


def calibration_set(folder: str | os.PathLike[str] | None = None) -> CalibrationSet:
    """The images of `folder`, or the photographs that come with the exporter; each is decoded once, to be sure of it.

    Parameters
    ----------
    folder : path, optional
        Its image files are taken, not those of folders inside; of more than 100, 100 spread evenly over their
        names.

    Raises
    ------
    ExportError
        If there is no such folder, no image in it, a file that `decoded` refuses, or nothing but flat images.
    """
    root = BUNDLED if folder is None else Path(folder)
    try:
        names = sorted(p.name for p in root.iterdir() if p.suffix.lower() in ENDINGS and p.is_file())
    except OSError as error:
        raise ExportError(f"{root}: not a folder of calibration images: {error.strerror or error}") from error
    if not names:
        raise ExportError(f"{root}: no image to calibrate with; files that end in {', '.join(ENDINGS)} are looked for")
    if len(names) > MOST_IMAGES:
        names = [names[i * len(names) // MOST_IMAGES] for i in range(MOST_IMAGES)]
    files = tuple(root / name for name in names)
    sha, flat = hashlib.sha256(), True
    for path in files:
        flat &= is_flat(decoded(path))
        try:
            sha.update(hashlib.sha256(path.read_bytes()).digest())
        except OSError as error:
            raise ExportError(f"{path}: {error.strerror or error}") from error
    if flat:
        raise ExportError(f"{root}: each image is of one colour throughout; take images that have texture")
    name = f"{len(files)} images of {root.resolve().name}" if folder is not None else "the exporter's photographs"
    return CalibrationSet(name, files, sha.hexdigest(), ready=folder is None)
