"""The features of an image as files, with a record of what they come from, by which a later run knows them again."""

from __future__ import annotations

import errno
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy.typing as npt

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ElfError
from elf_runtime.params import DetectionParams
from elf_runtime.pictures.explanation import draw_explanation
from elf_runtime.pictures.file import short_name, write_picture
from elf_runtime.pictures.render import detection_picture
from elf_runtime.results.features import load_record
from elf_runtime.results.files.npz import is_torn

from .frames import Frame
from .outcome import detected, failure, record_of_image
from .room import Room, memory_needed

_ENDS_ALL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)  # no image can be written any more


@dataclass
class Extractor:
    """Detects and writes, each image by itself; several threads may call it, not two of them for one name.

    Attributes
    ----------
    elf : ElfRuntime
    params : DetectionParams
    descriptor : str, optional
    mask : (H, W) bool array, optional
        Of all images.
    endings : sequence of str
        Of the files that each image gets: "npz", "csv", "png", "explain.png".
    record : mapping
        What an ``.npz`` says of model and settings.
    """

    elf: ElfRuntime
    params: DetectionParams
    descriptor: str | None
    mask: npt.NDArray[Any] | None
    endings: Sequence[str]
    record: Mapping[str, Any]
    ignore_exif: bool = False
    max_pixels: int | None = None
    skip_existing: bool = False
    overwrite: bool = False
    _room: Room = field(default_factory=Room)
    _written: dict[str, str] = field(default_factory=dict)  # results -> image

    def __call__(self, frame: Frame) -> dict[str, Any]:
        """Detect, describe and write; what became of it as plain data, with an ``error`` where it could not be done."""
        try:
            return self._extract(frame)
        except (ElfError, OSError) as error:
            if isinstance(error, OSError) and error.errno in _ENDS_ALL:
                raise
            return failure(frame, error)

    def _extract(self, frame: Frame) -> dict[str, Any]:
        start = time.perf_counter()
        files = [f"{frame.stem}.{ending}" for ending in self.endings]
        image = frame.open(self.max_pixels)
        record = record_of_image(self.record, frame, image)
        if self._existing(record, files):
            self._written[files[0]] = record["image"]
            return {**frame.told(), "files": files, "skipped": True}
        pixels = image.decoded(self.ignore_exif)
        read = time.perf_counter() - start
        with self._room(memory_needed(pixels.shape[:2], self.params)):
            trace = self.elf.trace(pixels, mask=self.mask, params=self.params, descriptor=self.descriptor)
        seconds = time.perf_counter() - start
        frame.stem.parent.mkdir(parents=True, exist_ok=True)
        # First the record of whose results these are.  What is left of earlier ones goes before it comes: an image that
        # is interrupted has files too few, never some of other settings.
        for file in files[1:]:
            Path(file).unlink(missing_ok=True)
        trace.features.save(f"{frame.stem}.npz", record)
        self._written[files[0]] = record["image"]
        if "csv" in self.endings:
            trace.features.save(f"{frame.stem}.csv")
        if "png" in self.endings:
            write_picture(Path(f"{frame.stem}.png"), detection_picture(pixels, trace, short_name(frame.name)))
        if "explain.png" in self.endings:
            sheet = draw_explanation(pixels, trace, short_name(frame.name))
            write_picture(Path(f"{frame.stem}.explain.png"), sheet)
        return detected(frame, files, trace, seconds, read)

    def _existing(self, record: Mapping[str, Any], files: Sequence[str]) -> bool:
        """Whether the files are there and need not be made again.

        Raises
        ------
        ElfError
            If they, or some of them, are not this image's results.
        """
        if files[0] in self._written:
            raise ElfError(f"{files[0]} holds the results of {self._written[files[0]]}; give another -o, or --base")
        there = [file for file in files if os.path.lexists(file)]
        if not there:
            return False
        found = load_record(files[0])
        same = found == json.loads(json.dumps(record)) and len(there) == len(files)
        if self.skip_existing and same:
            return True
        if self.overwrite or (self.skip_existing and is_torn(files[0])):
            return False
        if found is None or any(found.get(key) != record.get(key) for key in ("image", "frame")):
            whose = "is no result of elf-detect" if found is None else f"holds the results of {found.get('image')}"
            raise ElfError(f"{there[0]} {whose}; give another -o, or --base, or --overwrite")
        return False
