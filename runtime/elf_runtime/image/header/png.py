"""PNG: chunks, each with its length and kind, from IHDR to IEND."""

from __future__ import annotations

import struct
from typing import BinaryIO

from .form import MOST_EXIF, NEVER, SURELY, Format, Header


def _parse(head: bytes, file: BinaryIO) -> Header:
    width, height, depth, color = struct.unpack_from(">IIBB", head, 16)
    at, key = 8, None
    while True:  # chunk by chunk: profiles and comments of any length may stand before the transparency
        file.seek(at)
        chunk = file.read(10)
        if len(chunk) < 8 or chunk[4:8] in (b"IDAT", b"IEND"):
            return Header("PNG", width, height, SURELY if color in (4, 6) else NEVER)
        if chunk[4:8] == b"tRNS":
            if color == 0 and len(chunk) == 10:
                key = int.from_bytes(chunk[8:], "big") * (255 // ((1 << depth) - 1) if depth < 8 else 1)
            return Header("PNG", width, height, SURELY, key)
        at += 12 + int.from_bytes(chunk[:4], "big")


def exif(file: BinaryIO) -> bytes | None:
    """The TIFF file within a PNG's eXIf chunk, which may stand behind the pixels."""
    at = 8
    while True:
        file.seek(at)
        chunk = file.read(8)
        if len(chunk) < 8 or chunk[4:] == b"IEND":
            return None
        length = int.from_bytes(chunk[:4], "big")
        if chunk[4:] == b"eXIf":
            return file.read(min(length, MOST_EXIF))
        at += 12 + length


def _ends_early(data: bytes) -> bool:
    at = 8
    while True:
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        at += length + 12
        if kind == b"IEND" or at > len(data):
            return at > len(data)


PNG = Format("PNG", rb"\x89PNG\r\n\x1a\n", _parse, _ends_early)
