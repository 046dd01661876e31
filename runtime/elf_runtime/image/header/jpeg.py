"""JPEG: segments behind markers; the frame's has the size, and the scan's is followed by the compressed pixels."""

from __future__ import annotations

import struct
from typing import BinaryIO

from .form import Format, Header

_SCAN, _END, _APPLICATION_1 = 0xDA, 0xD9, 0xE1


def _is_alone(marker: int) -> bool:
    """Whether no length and no data follow: of padding, restarts, the start of the image, and TEM."""
    return marker == 0xFF or 0xD0 <= marker <= 0xD8 or marker == 0x01


def _parse(_: bytes, file: BinaryIO) -> Header:
    """By the frame header, which may lie behind megabytes of metadata."""
    at = 2
    while True:
        file.seek(at)
        segment = file.read(9)
        if len(segment) < 4 or segment[0] != 0xFF:
            return Header("JPEG")
        marker = segment[1]
        if _is_alone(marker):
            at += 1 if marker == 0xFF else 2
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", segment, 5)
            return Header("JPEG", width, height)
        if marker in (_END, _SCAN):
            return Header("JPEG")
        at += 2 + max(2, struct.unpack_from(">H", segment, 2)[0])


def exif(file: BinaryIO) -> bytes | None:
    """The TIFF file within a JPEG's EXIF segment."""
    at = 2
    while True:
        file.seek(at)
        segment = file.read(4)
        if len(segment) < 4 or segment[0] != 0xFF or segment[1] in (_END, _SCAN):
            return None
        if _is_alone(segment[1]):
            at += 1 if segment[1] == 0xFF else 2
            continue
        length = max(2, struct.unpack_from(">H", segment, 2)[0])
        if segment[1] == _APPLICATION_1 and (data := file.read(length - 2)).startswith(b"Exif\0\0"):
            return data[6:]
        at += 2 + length


def _ends_early(data: bytes) -> bool:
    # Thumbnails, which have such an end too, lie before the scan.
    return data.find(b"\xff\xd9", _scan(data)) < 0


def _scan(data: bytes) -> int:
    """Where the compressed pixels begin; the file's end where there are none."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == _SCAN:
            return at
        if _is_alone(marker):
            at += 1 if marker == 0xFF else 2
        else:
            at += 2 + max(2, struct.unpack_from(">H", data, at + 2)[0])
    return len(data)


JPEG = Format("JPEG", rb"\xff\xd8\xff", _parse, _ends_early)
