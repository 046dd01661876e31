"""Focal lengths in EXIF data."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime.image.exif import focal_length
from helpers import turned_jpeg

SIZE = (480, 640)
DIAGONAL = 800.0  # pixels of an image of that size
FILM = float(np.hypot(36, 24))
Entry = tuple[int, int, bytes]  # tag, kind, and four bytes: the value, or where it stands


def exif(order: str, entries: list[Entry], behind: bytes = b"", exif_tag: int = 0x8769) -> bytes:
    """EXIF data whose second directory, at byte 26, has entries; `behind` follows it."""
    mark = {"<": b"II", ">": b"MM"}[order]
    first = struct.pack(order + "HHHIII", 1, exif_tag, 4, 1, 26, 0)
    rows = b"".join(struct.pack(order + "HHI", tag, kind, 1) + value for tag, kind, value in entries)
    return (
        mark
        + struct.pack(order + "HI", 42, 8)
        + first
        + struct.pack(order + "H", len(entries))
        + rows
        + bytes(4)
        + behind
    )


def photo(folder: Path, data: bytes, before: bytes = b"") -> Path:
    """A JPEG with EXIF data, and other segments before them."""
    jpeg = cv2.imencode(".jpg", np.zeros((*SIZE, 3), np.uint8))[1].tobytes()
    body = b"Exif\0\0" + data
    path = folder / "a.jpg"
    path.write_bytes(jpeg[:2] + before + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:])
    return path


def short(order: str, value: int) -> bytes:
    return struct.pack(order + "HH", value, 0)


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("size", [SIZE, SIZE[::-1], (240, 320)])
def test_by_the_equivalent_on_film(order: str, size: tuple[int, int], tmp_path: Path) -> None:
    path = photo(tmp_path, exif(order, [(0xA405, 3, short(order, 28))]))
    assert focal_length(path, size) == pytest.approx(28 / FILM * np.hypot(*size))


def test_of_another_segment_and_padding_before_them(tmp_path: Path) -> None:
    xmp = b"http://ns.adobe.com/xap/1.0/\0<x/>"
    before = b"\xff\xe1" + struct.pack(">H", len(xmp) + 2) + xmp + b"\xff\xff"
    path = photo(tmp_path, exif("<", [(0xA405, 3, short("<", 50))]), before[:-1])
    assert focal_length(path, SIZE) == pytest.approx(50 / FILM * DIAGONAL)


@pytest.mark.parametrize(("unit", "per_millimetre"), [(2, 100.0), (3, 254.0), (None, 100.0)])
@pytest.mark.parametrize("taken", [640, 1280])
def test_by_the_sensor_s_resolution(unit: int | None, per_millimetre: float, taken: int, tmp_path: Path) -> None:
    order = ">"
    entries = [
        (0x920A, 5, struct.pack(">I", 100)),
        (0xA002, 4, struct.pack(">I", taken)),
        (0xA003, 3, short(order, taken * 3 // 4)),
        (0xA20E, 5, struct.pack(">I", 108)),
    ]
    entries += [(0xA210, 3, short(order, unit))] if unit else []
    head = exif(order, entries)
    values = struct.pack(">IIII", 7, 2, 2540, 1)  # 3.5 mm, 2540 pixels for each unit
    path = photo(tmp_path, head + bytes(100 - len(head)) + values)
    assert focal_length(path, SIZE) == pytest.approx(3.5 * per_millimetre * 640 / taken)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"II*\0",
        exif("<", []),
        exif("<", [(0xA405, 3, short("<", 0))]),
        exif("<", [(0x920A, 5, struct.pack("<I", 9999))]),
        exif("<", [(0x920A, 5, struct.pack("<I", 42)), (0xA20E, 5, struct.pack("<I", 42))], bytes(16)),
        exif("<", [(0xA405, 3, short("<", 28))], exif_tag=0x8825),
        exif("<", [(0xA405, 2, b"28\0\0")]),
    ],
)
def test_none_where_they_do_not_say_or_are_damaged(data: bytes, tmp_path: Path) -> None:
    assert focal_length(photo(tmp_path, data), SIZE) is None


def test_none_of_other_files(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(turned_jpeg(np.zeros((*SIZE, 3), np.uint8)))
    assert focal_length(tmp_path / "a.jpg", SIZE) is None
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    assert focal_length(tmp_path / "a.png", SIZE) is None
    with pytest.raises(OSError, match="No such file"):
        focal_length(tmp_path / "b.jpg", SIZE)
