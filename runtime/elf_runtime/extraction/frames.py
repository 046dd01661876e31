"""What a run of many images is made of: image files, and frames of videos and cameras, each with a name of its own."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ElfError
from elf_runtime.files.kind import open_regular
from elf_runtime.image.file import ImageFile
from elf_runtime.image.header import read_header
from elf_runtime.image.video import Video

FRAME_DIGITS = 6


class Opened(Protocol):
    """An image that can be told from others and is not decoded yet, such as an `ImageFile`."""

    @property
    def sha256(self) -> str: ...

    def decoded(self, ignore_exif: bool = False) -> npt.NDArray[Any]: ...


class Frame(Protocol):
    """An image of a run.

    Attributes
    ----------
    name : str
        For messages.
    stem : Path
        Where its results go, without an ending.
    """

    @property
    def name(self) -> str: ...

    @property
    def stem(self) -> Path: ...

    def told(self) -> dict[str, Any]:
        """Which image it is, as it was given, for a report."""

    def identity(self) -> dict[str, Any]:
        """Which image it is, whatever it is called, for a record."""

    def open(self, max_pixels: int | None) -> Opened:
        """Raises ImageError where it can't be read."""


@dataclass(frozen=True)
class Still:
    """An image file."""

    path: Path
    stem: Path

    @property
    def name(self) -> str:
        return str(self.path)

    def told(self) -> dict[str, Any]:
        return {"image": self.name}

    def identity(self) -> dict[str, Any]:
        return {"image": os.path.realpath(self.path)}

    def open(self, max_pixels: int | None) -> ImageFile:
        return ImageFile(self.path, max_pixels)

    def size(self) -> tuple[int, int] | None:
        """Height and width, of its header; None where it has none."""
        try:
            with open_regular(self.path) as file:
                header = read_header(file)
        except OSError:
            return None
        return (header.height, header.width) if header else None


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """A frame of a video or a camera, decoded."""

    video: str
    source: str
    number: int
    pixels: npt.NDArray[np.uint8]
    stem: Path

    @property
    def name(self) -> str:
        return f"{self.video}, frame {self.number}"

    def told(self) -> dict[str, Any]:
        return {"image": self.video, "frame": self.number}

    def identity(self) -> dict[str, Any]:
        return {"image": self.source, "frame": self.number}

    def open(self, _: int | None) -> VideoFrame:
        return self

    @property
    def sha256(self) -> str:
        """SHA-256 of its pixels."""
        return hashlib.sha256(np.ascontiguousarray(self.pixels).data).hexdigest()

    def decoded(self, _: bool = False) -> npt.NDArray[np.uint8]:
        return self.pixels


@dataclass(frozen=True)
class Unreadable:
    """A video that gives no more frames, or a folder that can't be listed, so that it is reported as an image is."""

    name: str
    stem: Path
    error: ElfError

    def told(self) -> dict[str, Any]:
        return {"image": self.name}

    identity = told

    def open(self, _: int | None) -> Opened:
        raise self.error


@dataclass(frozen=True)
class Clip:
    """A video file or a camera, and which of its frames are wanted.

    Attributes
    ----------
    source : Path or int
    stem : Path
        The folder that its frames' results go into.
    every : int
        Every so manieth frame.
    limit : int, optional
        At most so many.
    """

    source: Path | int
    stem: Path
    every: int = 1
    limit: int | None = None
    ignore_exif: bool = False
    max_pixels: int | None = None

    def frames(self) -> Iterator[Frame]:
        """Its frames as they are decoded; an `Unreadable` where it can't be opened or gives none."""
        # A camera has no frames to come back to: each run has a folder of its own.
        folder = self.stem / time.strftime("%Y%m%d-%H%M%S") if isinstance(self.source, int) else self.stem
        name = str(self.source)
        try:
            with Video(self.source, ignore_exif=self.ignore_exif, max_pixels=self.max_pixels) as video:
                name = video.name
                source = name if video.is_camera else os.path.realpath(name)
                for number, pixels in video.read(self.every, self.limit):
                    yield VideoFrame(name, source, number, pixels, folder / f"{number:0{FRAME_DIGITS}d}")
        except ElfError as error:
            yield Unreadable(name, folder, error)

    def count(self) -> int | None:
        """How many frames there will be, as far as the file says so."""
        if isinstance(self.source, int):
            return self.limit
        try:
            with Video(self.source) as video:
                frames = None if video.frames is None else -(-video.frames // self.every)
        except ElfError:
            return 1
        return frames if self.limit is None else min(frames or self.limit, self.limit)
