"""Kind, size and completeness of an image file, read from its header before anything is decoded.

A picture of a megabyte may unpack to gigabytes, and a decoder allocates them before it looks at the data.  A file for
each family of formats; `read_header` and `is_cut_off` are for all of them.
"""

from __future__ import annotations

import re
import struct
from typing import BinaryIO

from . import boxes, gif, jpeg, others, png, portable, tiff, webp
from .form import MAYBE, NEVER, SURELY, Format, Header

__all__ = ["MAYBE", "NEVER", "SURELY", "Header", "is_cut_off", "read_header"]

_HEAD = 1 << 16  # bytes in which all formats but JPEG and TIFF say their size

_FORMATS: tuple[Format, ...] = (
    png.PNG,
    jpeg.JPEG,
    webp.WEBP,
    others.BMP,
    tiff.TIFF,
    gif.GIF,
    portable.PNM,
    portable.PAM,
    portable.PFM,
    portable.HDR,
    boxes.JPEG_2000,
    boxes.HEIF,
    others.OPENEXR,
    others.SUN_RASTER,
)
_BY_KIND = {known.kind: known for known in _FORMATS}


def read_header(file: BinaryIO) -> Header | None:
    """The header of an image file that is open at its beginning; None where no kind of image is recognised."""
    head = file.read(_HEAD)
    for known in _FORMATS:
        if re.match(known.signature, head, re.DOTALL):
            try:
                return known.parse(head, file)
            except (struct.error, ValueError, IndexError, OverflowError):
                return Header(known.kind)
    return None


def is_cut_off(data: bytes, header: Header) -> bool:
    """Whether an image file ends before its format says that it does; False for formats that don't say."""
    ends_early = _BY_KIND[header.kind].ends_early
    try:
        return ends_early is not None and ends_early(data)
    except (struct.error, IndexError):
        return True
