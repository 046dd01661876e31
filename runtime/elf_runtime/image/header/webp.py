"""WebP: one RIFF chunk, of three forms."""

from __future__ import annotations

import struct
from typing import BinaryIO

from .form import MAYBE, NEVER, SURELY, Format, Header


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


def _ends_early(data: bytes) -> bool:
    return len(data) < int.from_bytes(data[4:8], "little") + 8


WEBP = Format("WebP", rb"RIFF....WEBP", _parse, _ends_early)
