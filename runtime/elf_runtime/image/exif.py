"""The focal length that a photograph's EXIF data state, in pixels: where no calibration is at hand."""

from __future__ import annotations

import io
import math
import os
import struct
from collections.abc import Mapping
from typing import BinaryIO

from elf_runtime.files.kind import open_regular

from .file import image_errors
from .header import Header, jpeg, png, read_header, webp
from .header.tiff import read_tags

_EXIF_TABLE, _FOCAL, _FOCAL_35 = 34665, 37386, 41989
_X_RESOLUTION, _RESOLUTION_UNIT, _WIDTH, _HEIGHT = 41486, 41488, 40962, 40963
_MILLIMETRES = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # of EXIF's units of resolution; 4 and 5 are TIFF/EP's
_FILM = math.hypot(36.0, 24.0)  # millimetres: the diagonal of 35 mm film
_EMBEDDED = {"JPEG": jpeg.exif, "PNG": png.exif, "WebP": webp.exif}
_FARTHEST = 1000.0  # image diagonals: no lens has a longer focal length


def focal_length_px(path: str | os.PathLike[str]) -> float | None:
    """The focal length of a JPEG, TIFF, PNG or WebP photograph, in pixels of the stored size; None where it says none.

    From FocalLengthIn35mmFilm f35, in whole millimetres, which relates to the diagonal (CIPA DCG-001),

        f = f35 sqrt(w^2 + h^2) / sqrt(36^2 + 24^2)

    or else from FocalLength f_mm and FocalPlaneXResolution r, pixels in each unit of u mm, of a photograph that had
    PixelXDimension x PixelYDimension pixels then,

        f = f_mm r / u  max(w, h) / max(PixelXDimension, PixelYDimension)

    Turning the image, as EXIF's orientation asks for, leaves it as it is.  What was cut off since can't be known: such
    an image's focal length is wrong.

    Raises
    ------
    ImageError
        If the file can't be opened.
    """
    with image_errors(path), open_regular(path) as file:
        header = read_header(file)
        if header is None or min(header.width, header.height) < 1:
            return None
        try:
            return _focal_length(_exif(file, header.kind), header)
        except (struct.error, ValueError, IndexError, OverflowError):
            return None


def _exif(file: BinaryIO, kind: str) -> dict[int, float]:
    """The tags of the EXIF table, which is one of a TIFF file within the file; empty where there is none."""
    within: BinaryIO | None = file
    if kind != "TIFF":
        data = _EMBEDDED[kind](file) if kind in _EMBEDDED else None
        within = None if data is None else io.BytesIO(data)
    if within is None:
        return {}
    within.seek(0)
    head = within.read(16)
    at = read_tags(head, within).get(_EXIF_TABLE)
    return {} if at is None else read_tags(head, within, int(at))


def _focal_length(tags: Mapping[int, float], header: Header) -> float | None:
    """See `focal_length_px`."""
    found = tags.get(_FOCAL_35, 0.0) * math.hypot(header.width, header.height) / _FILM
    if not found:
        unit = _MILLIMETRES.get(int(tags.get(_RESOLUTION_UNIT, 2)), math.inf)
        stored = max(header.width, header.height)
        before = max(tags.get(_WIDTH, 0.0), tags.get(_HEIGHT, 0.0)) or stored
        found = tags.get(_FOCAL, 0.0) * tags.get(_X_RESOLUTION, 0.0) / unit * stored / before
    return found if 0.0 < found < _FARTHEST * math.hypot(header.width, header.height) else None
