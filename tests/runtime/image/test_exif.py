"""The focal length that EXIF states, from files made here byte by byte."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path

import cv2
import pytest

from elf_runtime import ImageError
from elf_runtime.image.exif import focal_length_px
from exif_files import DSLR, HEIGHT, PHONE, WIDTH, exif, jpeg, table
from helpers import textured

# 50 mm, on 876 thousandths of an inch for 3888 pixels, of which 96 are left.
OF_DSLR = 50 / 25.4 * 3888 / 0.876 * 96 / 3888


def png(data: bytes) -> bytes:
    encoded = cv2.imencode(".png", textured(HEIGHT, WIDTH))[1].tobytes()
    chunk = len(data).to_bytes(4, "big") + b"eXIf" + data + zlib.crc32(b"eXIf" + data).to_bytes(4, "big")
    return encoded[:-12] + chunk + encoded[-12:]


def webp(data: bytes, prefix: bytes = b"") -> bytes:
    encoded = cv2.imencode(".webp", textured(HEIGHT, WIDTH))[1].tobytes()
    body, data = encoded[12:], prefix + data
    extended = b"VP8X" + struct.pack("<I", 10) + b"\x08\0\0\0" + (WIDTH - 1).to_bytes(3, "little")
    extended += (HEIGHT - 1).to_bytes(3, "little")
    chunk = b"EXIF" + struct.pack("<I", len(data)) + data + bytes(len(data) % 2)
    body = extended + body + chunk
    return b"RIFF" + struct.pack("<I", len(body) + 4) + b"WEBP" + body


def tiff(tags: dict[int, tuple[int, object]], order: str) -> bytes:
    """A grey TIFF: its table, then the EXIF table, then the pixels."""
    size = 8 + 2 + 12 * 9 + 4
    inner = table(tags, size, order)
    own: dict[int, tuple[int, object]] = {256: (3, WIDTH), 257: (3, HEIGHT), 258: (3, 8), 259: (3, 1), 262: (3, 1)}
    own |= {273: (4, size + len(inner)), 278: (3, HEIGHT), 279: (4, WIDTH * HEIGHT), 34665: (4, size)}
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    return head + table(own, 8, order) + inner + textured(HEIGHT, WIDTH, channels=1).tobytes()


def of(tmp_path: Path, name: str, data: bytes) -> float | None:
    path = tmp_path / name
    path.write_bytes(data)
    assert cv2.imread(str(path)).shape[:2] == (HEIGHT, WIDTH)
    return focal_length_px(path)


@pytest.mark.parametrize("order", "<>")
def test_every_kind_of_file(tmp_path: Path, order: str) -> None:
    data = exif(DSLR, order)
    for name, content in {
        "a.jpg": jpeg(data), "a.png": png(data), "a.webp": webp(data), "b.webp": webp(data, b"Exif\0\0"),
        "a.tif": tiff(DSLR, order),
    }.items():  # fmt: skip
        assert of(tmp_path, name, content) == pytest.approx(OF_DSLR, rel=1e-6), name


def test_the_equivalent_of_35_mm_film_relates_to_the_diagonal(tmp_path: Path) -> None:
    # 3:2 is film's own shape: there the width, 36 mm, gives the same.
    assert of(tmp_path, "a.jpg", jpeg(exif(PHONE))) == pytest.approx(28 / 36 * WIDTH)
    (tmp_path / "b.jpg").write_bytes(jpeg(exif(DSLR | PHONE), 64, 48))
    assert focal_length_px(tmp_path / "b.jpg") == pytest.approx(28 * 80 / math.hypot(36, 24))


def test_units_and_an_image_that_was_turned(tmp_path: Path) -> None:
    metric = DSLR | {41486: (5, (443836, 254)), 41488: (3, 3)}  # the same, per centimetre
    metric[41486] = (5, (round(3888000 / 876 / 2.54 * 1000), 1000))
    assert of(tmp_path, "a.jpg", jpeg(exif(metric))) == pytest.approx(OF_DSLR, rel=1e-5)
    (tmp_path / "b.jpg").write_bytes(jpeg(exif(DSLR), HEIGHT, WIDTH))
    assert focal_length_px(tmp_path / "b.jpg") == pytest.approx(OF_DSLR, rel=1e-6)
    never_resized = {tag: value for tag, value in DSLR.items() if tag not in (40962, 40963)}
    assert of(tmp_path, "c.jpg", jpeg(exif(never_resized))) == pytest.approx(OF_DSLR * 3888 / 96, rel=1e-6)


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {37386: (5, (50, 1))},
        {41989: (3, 0)},
        DSLR | {37386: (5, (50, 0))},
        DSLR | {37386: (5, (0, 1))},
        DSLR | {41488: (3, 1)},
        DSLR | {37386: (5, (4294967295, 1))},
    ],
)
def test_none_where_it_is_not_stated(tmp_path: Path, tags: dict[int, tuple[int, object]]) -> None:
    assert of(tmp_path, "a.jpg", jpeg(exif(tags))) is None


def test_files_without_and_damaged_ones(tmp_path: Path) -> None:
    for name in ("a.jpg", "a.png", "a.webp", "a.tif", "a.bmp"):
        cv2.imwrite(str(tmp_path / name), textured(HEIGHT, WIDTH))
        assert focal_length_px(tmp_path / name) is None
    whole = exif(DSLR)
    for cut in range(0, len(whole), 7):
        for name, data in {"b.jpg": jpeg(whole[:cut]), "b.png": png(whole[:cut]), "b.webp": webp(whole[:cut])}.items():
            (tmp_path / name).write_bytes(data)
            focal_length_px(tmp_path / name)
    (tmp_path / "no.txt").write_text("no image")
    assert focal_length_px(tmp_path / "no.txt") is None
    with pytest.raises(ImageError, match=r"absent\.jpg: No such file"):
        focal_length_px(tmp_path / "absent.jpg")
