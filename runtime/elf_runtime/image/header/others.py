"""Formats whose size has a fixed place, or nearly: BMP, OpenEXR and Sun raster."""

from __future__ import annotations

import struct
from typing import BinaryIO

from .form import MAYBE, NEVER, Format, Header, two_numbers


def _bmp(head: bytes, _: BinaryIO) -> Header:
    if struct.unpack_from("<I", head, 14)[0] == 12:  # OS/2's header
        width, height = struct.unpack_from("<HH", head, 18)
        return Header("BMP", width, height)
    width, height, _planes, bits = struct.unpack_from("<iiHH", head, 18)
    return Header("BMP", abs(width), abs(height), MAYBE if bits == 32 else NEVER)


def _bmp_ends_early(data: bytes) -> bool:
    return len(data) < int.from_bytes(data[2:6], "little")


def _openexr(head: bytes, _: BinaryIO) -> Header:
    at = head.index(b"dataWindow\0box2i\0") + 17 + 4
    left, top, right, bottom = struct.unpack_from("<iiii", head, at)
    return Header("OpenEXR", abs(right - left) + 1, abs(bottom - top) + 1, MAYBE)


BMP = Format("BMP", rb"BM", _bmp, _bmp_ends_early)
OPENEXR = Format("OpenEXR", rb"\x76\x2f\x31\x01", _openexr)
SUN_RASTER = Format("Sun raster", rb"\x59\xa6\x6a\x95", two_numbers("Sun raster", ">II", 4, NEVER))
