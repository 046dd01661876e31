"""Image files and arrays with something wrong: headers, sizes, chunks, bytes; dtypes, shapes, values, strides."""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

ENDINGS = (
    ".png", ".jpg", ".webp", ".bmp", ".tiff", ".ppm", ".pgm", ".gif", ".hdr", ".jp2", ".pam", ".pfm", ".ras", ".avif",
)  # fmt: skip
SIDES = (0, 1, 31, 32, 33, 255, 4097, 30000, 65535, 1 << 20, (1 << 31) - 1, (1 << 32) - 1)


def seeds() -> dict[str, bytes]:
    """A small picture in every format that this build of OpenCV writes, with alpha and in 16 bits too."""
    rng = np.random.default_rng(0)
    picture = cv2.resize(rng.integers(0, 256, (24, 32, 4), np.uint8), (128, 96), interpolation=cv2.INTER_CUBIC)
    found = {}
    for ending in ENDINGS:
        for name, array in (
            ("", picture[:, :, :3]), ("-alpha", picture), ("-16", picture[:, :, :3].astype(np.uint16) * np.uint16(257)),
            ("-float", picture[:, :, :3].astype(np.float32) / 255), ("-grey", picture[:, :, 0]),
        ):  # fmt: skip
            try:
                done, data = cv2.imencode(ending, array)
            except cv2.error:
                continue
            if done:
                found[f"a{name}{ending}"] = data.tobytes()
    return found


def files(seed: int) -> Iterator[tuple[str, str, bytes]]:
    """Endless mutants: what was changed, the file's ending, its bytes."""
    rng = random.Random(seed)
    whole = seeds()
    while True:
        name = rng.choice(sorted(whole))
        data = whole[name]
        ending = "." + name.rpartition(".")[2]
        way = rng.choice(("size", "size", "cut", "bytes", "bytes", "behind", "front", "swap", "repeat", "header"))
        if way == "size" and ending == ".png":
            what, data = _png_size(data, rng)
        elif way in ("size", "header"):
            at = rng.randrange(min(len(data), 64))
            number = struct.pack(rng.choice(("<I", ">I", "<H", ">H")), rng.choice(SIDES) & 0xFFFF)
            data, what = data[:at] + number + data[at + len(number) :], f"header at {at}"
        elif way == "cut":
            length = rng.randrange(len(data))
            data, what = data[:length], f"cut at {length}"
        elif way == "bytes":
            changed = bytearray(data)
            for _ in range(rng.choice((1, 2, 8, 64))):
                changed[rng.randrange(len(data))] = rng.randrange(256)
            data, what = bytes(changed), "bytes"
        elif way == "behind":
            data, what = data + rng.randbytes(rng.randrange(1, 500)), "junk behind"
        elif way == "front":
            data, what = rng.randbytes(rng.randrange(1, 20)) + data, "junk in front"
        elif way == "swap":
            other = whole[rng.choice(sorted(whole))]
            at = rng.randrange(min(len(data), len(other)))
            data, what = data[:at] + other[at:], f"another format from {at} on"
        else:
            at = rng.randrange(len(data))
            data, what = data[:at] + data[at // 2 :], f"a part twice from {at} on"
        yield f"{name}: {what}", ending, data


def _png_size(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    """A PNG that says another size, or depth, with the right check sum."""
    header = bytearray(data[16:29])
    width, height = rng.choice(SIDES), rng.choice(SIDES)
    struct.pack_into(">II", header, 0, width & 0xFFFFFFFF, height & 0xFFFFFFFF)
    if rng.random() < 0.3:
        header[8:10] = bytes([rng.choice((1, 2, 4, 8, 16, 99)), rng.choice((0, 2, 3, 4, 6, 7))])
    check = zlib.crc32(b"IHDR" + bytes(header)).to_bytes(4, "big")
    return f"says {width}x{height}", data[:16] + bytes(header) + check + data[33:]


DTYPES = (
    "?", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8", "g", "c8", "c16", "O", "U3", "S3", "M8[s]",
    "m8[s]", "V4", ">u2", ">f4", ">f8", "u1,f4",
)  # fmt: skip
SHAPES = (
    (), (0,), (5,), (64, 64), (64, 64, 1), (64, 80, 3), (64, 80, 4), (64, 80, 2), (64, 80, 5), (3, 64, 80),
    (1, 64, 80, 3), (0, 64, 3), (64, 0), (64, 64, 0), (31, 64), (32, 32), (1, 1, 1, 1, 1), (32, 4000), (4000, 32),
    (33, 47, 3),
)  # fmt: skip


def arrays(seed: int) -> Iterator[tuple[str, Any]]:
    """Endless arrays that somebody may take for an image, and some other things."""
    rng = random.Random(seed)
    numbers = np.random.default_rng(seed)
    while True:
        if rng.random() < 0.05:
            other = rng.choice((None, 5, 1.5, "nowhere.png", b"bytes", [], [[1, 2], [3, 4]], {}, object(), ""))
            yield f"{other!r}"[:40], other
            continue
        dtype, shape = rng.choice(DTYPES), rng.choice(SHAPES)
        raw = numbers.integers(0, 256, (*shape, np.dtype(dtype).itemsize), np.uint8)
        with np.errstate(all="ignore"):
            if dtype == "O":
                array = np.full(shape, rng.choice((None, 1, "a", 10**400)), object)
            elif np.dtype(dtype).kind in "fg" and rng.random() < 0.7:
                array = numbers.random(shape).astype(dtype)
            else:
                array = np.zeros(shape, dtype)
                if array.size:
                    array = np.ndarray(shape, dtype, raw.tobytes()).copy()
            what = f"{dtype} {shape}"
            if array.dtype.kind == "f" and array.size and rng.random() < 0.3:
                value = rng.choice((np.nan, np.inf, -np.inf, -1e-7, 1 + 1e-7, 2.0, 1e30, -0.0))
                array.ravel()[rng.randrange(array.size)] = value
                what += f" with {value}"
            way = rng.randrange(8)
            if way == 0 and array.ndim > 1:
                array, what = array[::-1, ::2], what + " strided"
            elif way == 1:
                array, what = np.asfortranarray(array), what + " Fortran"
            elif way == 2 and array.ndim > 1 and array.size:
                sides = rng.choice(((10**6, 10**6), (64, 64), (20000, 20000)))
                array = np.broadcast_to(array[:1, :1], sides + array.shape[2:])
                what += " broadcast"
            elif way == 3:
                array, what = np.ma.masked_array(array, mask=np.zeros(shape, bool)), what + " masked"
            elif way == 4:
                array.flags.writeable = False
                what += " read-only"
        yield what, array
