"""The focal length that a camera wrote into a photograph's EXIF data."""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Callable

from elf_runtime.files.kind import open_regular

from .header.jpeg import read_exif

_EXIF_TAGS, _FOCAL, _FOCAL_35 = 0x8769, 0x920A, 0xA405
_WIDTH, _HEIGHT, _PLANE_RESOLUTION, _PLANE_UNIT = 0xA002, 0xA003, 0xA20E, 0xA210
_MILLIMETRES = {2: 25.4, 3: 10.0}  # of a unit of the sensor's resolution
_DIAGONAL_35 = math.hypot(36.0, 24.0)
_MOST_TAGS = 1024


def focal_length(path: str | os.PathLike[str], image_size: tuple[int, int]) -> float | None:
    """Focal length in pixels of the image, from the EXIF data of a JPEG file.

    By ``FocalLengthIn35mmFilm``, whose film has a diagonal of 43.3 mm (CIPA DCG-001); else by ``FocalLength`` and the
    sensor's resolution, ``FocalPlaneXResolution``, of the photograph as it was taken.  A resized copy keeps its angle
    of view.  One that was cropped does not, and EXIF data do not say so.

    Parameters
    ----------
    path : path
    image_size : (height, width)
        Of the image as it is now; turned or not.

    Returns
    -------
    float or None
        None where the file does not say, or is no JPEG file.

    Raises
    ------
    OSError
        If the file can't be read.
    """
    with open_regular(path) as file:
        if file.read(3) != b"\xff\xd8\xff":
            return None
        data = read_exif(file)
    try:
        return _focal(data, image_size)
    except (struct.error, ZeroDivisionError):  # damaged, or 0/0 for "unknown"
        return None


def _focal(data: bytes, image_size: tuple[int, int]) -> float | None:
    order = "<" if data[:2] == b"II" else ">"
    first = _tags(data, order, struct.unpack_from(order + "I", data, 4)[0])
    tags = _tags(data, order, int(first[_EXIF_TAGS])) if _EXIF_TAGS in first else {}
    height, width = image_size
    found = 0.0
    if tags.get(_FOCAL_35):
        found = tags[_FOCAL_35] * math.hypot(height, width) / _DIAGONAL_35
    elif _FOCAL in tags and _PLANE_RESOLUTION in tags:
        per_millimetre = tags[_PLANE_RESOLUTION] / _MILLIMETRES.get(int(tags.get(_PLANE_UNIT, 2)), 25.4)
        found = tags[_FOCAL] * per_millimetre * max(height, width) / max(tags.get(_WIDTH, 0.0), tags.get(_HEIGHT, 0.0))
    return found if found > 0 and math.isfinite(found) else None


def _tags(data: bytes, order: str, at: int) -> dict[int, float]:
    """The first value of each tag that is a number, of the directory at a place of the data."""
    (entries,) = struct.unpack_from(order + "H", data, at)
    found: dict[int, float] = {}
    for entry in range(min(entries, _MOST_TAGS)):
        place = at + 2 + 12 * entry
        tag, kind = struct.unpack_from(order + "HH", data, place)
        if kind in _VALUES and (kind != 5 or tag in (_FOCAL, _PLANE_RESOLUTION)):
            found[tag] = _VALUES[kind](data, order, place + 8)
    return found


def _short(data: bytes, order: str, at: int) -> float:
    return float(struct.unpack_from(order + "H", data, at)[0])


def _long(data: bytes, order: str, at: int) -> float:
    return float(struct.unpack_from(order + "I", data, at)[0])


def _rational(data: bytes, order: str, at: int) -> float:
    numerator, denominator = struct.unpack_from(order + "II", data, struct.unpack_from(order + "I", data, at)[0])
    return float(numerator / denominator)


_VALUES: dict[int, Callable[[bytes, str, int], float]] = {3: _short, 4: _long, 5: _rational}
