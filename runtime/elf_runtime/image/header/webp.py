"""WebP: one RIFF chunk, of three forms."""

from __future__ import annotations

import struct
from typing import BinaryIO

from .form import MAYBE, MOST_EXIF, NEVER, SURELY, Format, Header


def _parse(head: bytes, _: BinaryIO) -> Header:
    form = head[12:16]
    if form == b"VP8X":
        width, height = (int.from_bytes(head[at : at + 3], "little") + 1 for at in (24, 27))
        return Header("WebP", width, height, SURELY if head[20] & 0x10 else NEVER)
    if form == b"VP8L":
        (bits,) = struct.unpack_from("<I", head, 21)
        return Header("WebP", (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1, MAYBE if bits >> 28 & 1 else NEVER)
    width, height = struct.unpack_from("<HH", head, 26)
    return Header("WebP", width & 0x3FFF, height & 0x3FFF)


def exif(file: BinaryIO) -> bytes | None:
    """The TIFF file within a WebP's EXIF chunk, behind the pixels; some writers put JPEG's identifier before it."""
    at = 12
    while True:
        file.seek(at)
        chunk = file.read(8)
        if len(chunk) < 8:
            return None
        length = int.from_bytes(chunk[4:], "little")
        if chunk[:4] == b"EXIF":
            return file.read(min(length, MOST_EXIF)).removeprefix(b"Exif\0\0")
        at += 8 + length + length % 2


def _ends_early(data: bytes) -> bool:
    return len(data) < int.from_bytes(data[4:8], "little") + 8


WEBP = Format("WebP", rb"RIFF....WEBP", _parse, _ends_early)
