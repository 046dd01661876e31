"""Alpha in PNG, TIFF and PAM files: read where the file says so, and never misread."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ImageError
from elf_runtime.image import read
from helpers import textured


@pytest.mark.parametrize("orientation", range(1, 9))
def test_alpha_turns_with_the_picture(tmp_path: Path, orientation: int) -> None:
    """A PNG may carry an orientation too; OpenCV obeys it for the colours only."""
    image = np.dstack([textured(40, 60), textured(40, 60, 1)[:, :, 0]])
    data = cv2.imencode(".png", image)[1].tobytes()
    exif = b"MM\0*\0\0\0\x08\0\1\x01\x12\0\3\0\0\0\1" + bytes([0, orientation, 0, 0]) + bytes(4)
    chunk = len(exif).to_bytes(4, "big") + b"eXIf" + exif + zlib.crc32(b"eXIf" + exif).to_bytes(4, "big")
    (tmp_path / "turned.png").write_bytes(data[:33] + chunk + data[33:])
    found = read(tmp_path / "turned.png")
    colours = cv2.imread(str(tmp_path / "turned.png"))
    np.testing.assert_array_equal(found[:, :, :3], colours)
    turns = {tuple(row) for row in np.dstack([found]).reshape(-1, 4).tolist()}
    assert turns == {tuple(row) for row in image.reshape(-1, 4).tolist()}  # each pixel kept its own alpha


def png(width: int, height: int, *chunks: tuple[bytes, bytes]) -> bytes:
    """A grey or coloured PNG from its chunks behind the header's."""
    parts = [b"\x89PNG\r\n\x1a\n"]
    for kind, data in chunks:
        parts.append(len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big"))
    return b"".join(parts)


@pytest.mark.parametrize("before", [b"", b"IDAT in a comment", bytes(100_000)], ids=["none", "word", "long"])
@pytest.mark.parametrize(("depth", "color"), [(8, 0), (16, 0), (4, 0), (8, 2), (8, 3)])
def test_a_png_may_name_a_colour_that_is_no_image(tmp_path: Path, before: bytes, depth: int, color: int) -> None:
    rng = np.random.default_rng(0)
    values = rng.integers(0, 1 << depth, (40, 60))
    values[:, :20] = 3  # what is transparent
    if color == 0:
        pixels = values.astype(">u2").view(np.uint8).reshape(40, 120) if depth == 16 else values.astype(np.uint8)
        pixels = pixels[:, ::2] << 4 | pixels[:, 1::2] if depth == 4 else pixels
        special = (3).to_bytes(2, "big")
    elif color == 2:
        pixels = np.repeat(values.astype(np.uint8), 3, axis=1)
        special = (3).to_bytes(2, "big") * 3
    else:
        pixels, special = values.astype(np.uint8), bytes([255, 255, 255, 0])
    raw = b"".join(b"\0" + row.tobytes() for row in pixels)
    palette = [(b"PLTE", bytes(range(256)) * 3)] if color == 3 else []
    header = struct.pack(">IIBBBBB", 60, 40, depth, color, 0, 0, 0)
    data = png(60, 40, (b"IHDR", header), (b"tEXt", b"Comment\0" + before), *palette, (b"tRNS", special),
               (b"IDAT", zlib.compress(raw)), (b"IEND", b""))  # fmt: skip
    (tmp_path / "a.png").write_bytes(data)
    found = read(tmp_path / "a.png")
    assert found.shape == (40, 60, 4)
    np.testing.assert_array_equal(found[:, :, 3] == 0, values == 3)
    assert found.dtype == (np.uint16 if depth == 16 else np.uint8)


@pytest.mark.parametrize("extra", [0, 1, 2, None])
@pytest.mark.parametrize("order", ["<", ">"])
def test_a_tiff_s_fourth_channel_is_alpha_only_if_it_says_so(tmp_path: Path, extra: int | None, order: str) -> None:
    pixels = textured(40, 60, channels=4)
    pixels[:, :20, 3] = 0
    tags = [(256, 4, 1, 60), (257, 4, 1, 40), (258, 3, 4, 200), (259, 3, 1, 1), (262, 3, 1, 2), (273, 4, 1, 300),
            (277, 3, 1, 4), (278, 4, 1, 40), (279, 4, 1, pixels.size)]  # fmt: skip
    tags += [(338, 3, 1, extra)] if extra is not None else []
    rows = b"".join(
        struct.pack(f"{order}HHI", tag, kind, count)
        + (struct.pack(f"{order}HH", value, 0) if kind == 3 and count == 1 else struct.pack(f"{order}I", value))
        for tag, kind, count, value in tags
    )
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}IH", 8, len(tags)) + rows + bytes(4)
    data = head.ljust(200, b"\0") + struct.pack(f"{order}4H", 8, 8, 8, 8)
    (tmp_path / "a.tiff").write_bytes(data.ljust(300, b"\0") + pixels.tobytes())
    found = read(tmp_path / "a.tiff")
    assert found.shape == (40, 60, 3 if extra == 0 else 4)
    if extra != 0:
        np.testing.assert_array_equal(found[:, :, 3], pixels[:, :, 3])


def test_alpha_that_opencv_does_not_decode_is_no_secret(tmp_path: Path) -> None:
    """A grey TIFF with alpha."""
    pixels = textured(40, 60, channels=2)
    tags = [(256, 4, 60), (257, 4, 40), (258, 3, 8), (259, 3, 1), (262, 3, 1), (273, 4, 300), (277, 3, 2), (278, 4, 40),
            (279, 4, pixels.size), (338, 3, 2)]  # fmt: skip
    rows = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    head = b"II*\0" + struct.pack("<IH", 8, len(tags)) + rows + bytes(4)
    (tmp_path / "a.tiff").write_bytes(head.ljust(300, b"\0") + pixels.tobytes())
    if cv2.imread(str(tmp_path / "a.tiff"), cv2.IMREAD_UNCHANGED) is not None:
        with pytest.raises(ImageError, match=r"a\.tiff: the TIFF file has an alpha channel that OpenCV does not"):
            read(tmp_path / "a.tiff")


@pytest.mark.parametrize("bits", [8, 16])
def test_planar_tiffs_and_pams_with_alpha_are_not_misread(tmp_path: Path, bits: int) -> None:
    """OpenCV decodes some of them to other pixels."""
    pixels = textured(40, 60).astype(np.uint8 if bits == 8 else np.uint16)
    size = pixels[:, :, 0].nbytes
    tags = [(256, 4, 1, 60), (257, 4, 1, 40), (258, 3, 3, 200), (259, 3, 1, 1), (262, 3, 1, 2), (273, 4, 3, 220),
            (277, 3, 1, 3), (278, 4, 1, 40), (279, 4, 3, 240), (284, 3, 1, 2)]  # fmt: skip
    rows = b"".join(struct.pack("<HHII", *tag) for tag in tags)
    head = (b"II*\0" + struct.pack("<IH", 8, len(tags)) + rows + bytes(4)).ljust(200, b"\0")
    head = (head + struct.pack("<3H", bits, bits, bits)).ljust(220, b"\0")
    head += struct.pack("<3I", *(300 + size * i for i in range(3))).ljust(20, b"\0") + struct.pack("<3I", *[size] * 3)
    planes = b"".join(pixels[:, :, c].tobytes() for c in (2, 1, 0))  # red first
    (tmp_path / "planar.tiff").write_bytes(head.ljust(300, b"\0") + planes)
    if bits == 8:
        np.testing.assert_array_equal(read(tmp_path / "planar.tiff"), pixels)
    else:
        with pytest.raises(ImageError, match="it is a planar TIFF of 16 bits, which OpenCV misreads; convert it"):
            read(tmp_path / "planar.tiff")
    for depth in (2, 4):
        data = f"P7\nWIDTH 60\nHEIGHT 40\nDEPTH {depth}\nMAXVAL 255\nENDHDR\n".encode() + bytes(60 * 40 * depth)
        (tmp_path / "a.pam").write_bytes(data)
        with pytest.raises(ImageError, match="it is a PAM picture with alpha, which OpenCV misreads"):
            read(tmp_path / "a.pam")
