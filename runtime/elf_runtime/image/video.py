"""The frames of a video file or a camera, in their order, decoded one at a time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ImageError
from elf_runtime.files.kind import HEAD, description, open_regular

from .file import MAX_PIXELS, check_pixels, image_errors

VIDEO_SUFFIXES = frozenset((".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".ts", ".webm", ".wmv"))

_LEAST = 0.9  # of the frames that a file says it has, since some count loosely


class Video:
    """A video file, or a camera by its number, that is open.

    Parameters
    ----------
    source : path or int
    ignore_exif : bool
        Frames as they are stored; by default they are turned as the file says (phones held upright).
    max_pixels : int, optional
        Larger frames are refused.

    Attributes
    ----------
    name : str
        The path, or "camera 0".
    frames : int, optional
        How many the file says it has, which may be off by a few; None for a camera, or where it does not say.

    Raises
    ------
    ImageError
        If the file is missing, or no video that this build of OpenCV decodes; if there is no such camera.
    """

    def __init__(
        self, source: str | os.PathLike[str] | int, *, ignore_exif: bool = False, max_pixels: int | None = MAX_PIXELS
    ) -> None:
        self.is_camera = isinstance(source, int)
        self.name = f"camera {source}" if isinstance(source, int) else os.fsdecode(source)
        self._max_pixels = max_pixels
        with image_errors(self.name):
            head = b""
            if not isinstance(source, int):
                with open_regular(source) as file:
                    head = file.read(HEAD)
            self._capture = cv2.VideoCapture(source if isinstance(source, int) else self.name)
            if not self._capture.isOpened():
                raise ImageError(_unopened(source, head))
        if not self.is_camera:
            self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0 if ignore_exif else 1)
        count = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.frames = count if count > 0 and not self.is_camera else None

    def read(self, every: int = 1, limit: int | None = None) -> Iterator[tuple[int, npt.NDArray[np.uint8]]]:
        """Every so manieth frame: its number, from 0, and its pixels, (H, W, 3) uint8 BGR; at most `limit` of them.

        Frames between are not converted to pixels.

        Raises
        ------
        ImageError
            If there is no frame at all, or one has more pixels than `max_pixels`; after the last one, if the file says
            that it has far more.
        """
        number = given = 0
        while (limit is None or given < limit) and self._capture.grab():
            if number % every == 0:
                done, pixels = self._capture.retrieve()
                if done:
                    with image_errors(f"{self.name}, frame {number}"):
                        check_pixels(pixels.shape, self._max_pixels)
                    yield number, pixels
                    given += 1
            number += 1
        ended = limit is None or given < limit
        if ended and not number:
            raise ImageError(f"{self.name}: it gives no frame")
        if ended and self.frames is not None and number < _LEAST * self.frames:
            raise ImageError(f"{self.name}: it ends after {number} of {self.frames} frames, as a file that is cut off")

    def close(self) -> None:
        self._capture.release()

    def __enter__(self) -> Video:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


def _unopened(source: Any, head: bytes) -> str:
    if isinstance(source, int):
        return "there is no such camera, or another program has it"
    what, unknown = description(head), "not a video that OpenCV can decode"
    return f"{unknown}: it is {what}" if what else unknown
