"""Formats of boxes within boxes: JPEG 2000, AVIF and HEIF.  The box with the size is found by its name."""

from __future__ import annotations

import re
import struct
from typing import BinaryIO

from .form import MAYBE, NEVER, SURELY, Format, Header


def _jpeg_2000(head: bytes, _: BinaryIO) -> Header:
    at = head.find(b"ihdr")
    if at >= 0:
        height, width, channels = struct.unpack_from(">IIH", head, at + 4)
        return Header("JPEG 2000", width, height, {2: SURELY, 4: MAYBE}.get(channels, NEVER))
    # A bare code stream: the sizes stand in its SIZ marker.
    right, bottom, left, top = struct.unpack_from(">IIII", head, head.find(b"\xff\x51") + 6)
    return Header("JPEG 2000", right - left, bottom - top, MAYBE)


def _heif(head: bytes, _: BinaryIO) -> Header:
    """By the largest of the pictures in it: the others are thumbnails."""
    sides = [struct.unpack_from(">II", head, found.end() + 4) for found in re.finditer(b"ispe", head)]
    width, height = max(sides, key=lambda size: size[0] * size[1], default=(0, 0))
    return Header("AVIF or HEIF", width, height, MAYBE)


JPEG_2000 = Format("JPEG 2000", rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51", _jpeg_2000)
HEIF = Format("AVIF or HEIF", rb"....ftyp(avif|avis|heic|heix|mif1|msf1)", _heif)
