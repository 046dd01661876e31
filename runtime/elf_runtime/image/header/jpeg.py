"""JPEG: segments behind markers; the frame's has the size, and the scan's is followed by the compressed pixels."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

from .form import Format, Header

_SCAN, _END, _APP1 = 0xDA, 0xD9, 0xE1
_EXIF = b"Exif\0\0"


def _is_alone(marker: int) -> bool:
    """Whether no length and no data follow: of padding, restarts, the start of the image, and TEM."""
    return marker == 0xFF or 0xD0 <= marker <= 0xD8 or marker == 0x01


def _parse(_: bytes, file: BinaryIO) -> Header:
    """By the frame header, which may lie behind megabytes of metadata."""
    for marker, at in _segments(file):
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            file.seek(at + 5)
            height, width = struct.unpack(">HH", file.read(4))
            return Header("JPEG", width, height)
    return Header("JPEG")


def read_exif(file: BinaryIO) -> bytes:
    """The EXIF data of a JPEG file, which are laid out as a TIFF file; empty where it has none."""
    for marker, at in _segments(file):
        if marker == _APP1:
            file.seek(at + 2)
            (length,) = struct.unpack(">H", file.read(2))
            data = file.read(length - 2) if length > 2 else b""
            if data.startswith(_EXIF):
                return data[len(_EXIF) :]
    return b""


def _segments(file: BinaryIO) -> Iterator[tuple[int, int]]:
    """Marker and place of each segment, up to the scan or to what is no segment."""
    at = 2
    while True:
        file.seek(at)
        segment = file.read(4)
        if len(segment) < 4 or segment[0] != 0xFF:
            return
        marker = segment[1]
        if _is_alone(marker):
            at += 1 if marker == 0xFF else 2
            continue
        if marker in (_END, _SCAN):
            return
        yield marker, at
        at += 2 + max(2, struct.unpack_from(">H", segment, 2)[0])


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
