"""Photographs with EXIF data, made byte by byte."""

from __future__ import annotations

import struct

import cv2
import numpy as np

from helpers import textured

WIDTH, HEIGHT = 96, 64  # 3:2, as film's
DSLR = {37386: (5, (50, 1)), 41486: (5, (3888000, 876)), 41488: (3, 2), 40962: (4, 3888), 40963: (4, 2592)}
PHONE = {37386: (5, (4, 1)), 41989: (3, 28)}


def table(tags: dict[int, tuple[int, object]], at: int, order: str) -> bytes:
    """A TIFF table at byte `at`: fractions lie behind it."""
    rows, behind = b"", b""
    end = at + 2 + 12 * len(tags) + 4
    for tag, (kind, value) in sorted(tags.items()):
        if kind == 5:
            field = struct.pack(order + "I", end + len(behind))
            behind += struct.pack(order + "II", *value)  # type: ignore[misc]
        else:
            field = struct.pack(order + {3: "Hxx", 4: "I"}[kind], value)
        rows += struct.pack(order + "HHI", tag, kind, 1) + field
    return struct.pack(order + "H", len(tags)) + rows + bytes(4) + behind


def exif(tags: dict[int, tuple[int, object]], order: str = "<") -> bytes:
    """A TIFF file that has nothing but the EXIF table."""
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    first = table({34665: (4, 26)}, 8, order)
    return head + first + table(tags, 26, order)


def jpeg(data: bytes, width: int = WIDTH, height: int = HEIGHT, pixels: np.ndarray | None = None) -> bytes:
    """A JPEG of a texture, or of `pixels`, with these EXIF data."""
    encoded = cv2.imencode(".jpg", textured(height, width) if pixels is None else pixels)[1].tobytes()
    before = b"\xff\xe1" + struct.pack(">H", 2 + 8) + b"http://x"  # XMP comes in such a segment too
    segment = b"\xff\xe1" + struct.pack(">H", len(data) + 8) + b"Exif\0\0" + data
    return encoded[:2] + before + segment + encoded[2:]
