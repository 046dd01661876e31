"""TIFF and BigTIFF: a table of tags, anywhere in the file."""

from __future__ import annotations

import struct
from typing import BinaryIO

from .form import MAYBE, NEVER, SURELY, Format, Header

_WIDTH, _HEIGHT, _BITS, _PHOTOMETRIC, _SAMPLES, _PLANAR, _EXTRA = 256, 257, 258, 262, 277, 284, 338
_CODES = {1: "B", 3: "H", 4: "I", 5: "II", 16: "Q"}  # struct's, by TIFF's number of a type
_MOST_TAGS = 4096


def _parse(head: bytes, file: BinaryIO) -> Header:
    tags = {tag: int(value) for tag, value in read_tags(head, file).items()}
    width, height, samples = tags.get(_WIDTH, 0), tags.get(_HEIGHT, 0), tags.get(_SAMPLES, 1)
    if tags.get(_PLANAR) == 2 and samples > 1 and tags.get(_BITS) != 8:
        return Header("TIFF", width, height, misread=f"a planar TIFF of {tags[_BITS]} bits")
    if _EXTRA in tags:  # 1 and 2 are alpha, 0 is anything else, such as infrared
        return Header("TIFF", width, height, SURELY if tags[_EXTRA] in (1, 2) else NEVER)
    # OpenCV itself writes four channels of an RGB picture without saying what the fourth is.
    return Header("TIFF", width, height, MAYBE if (samples, tags.get(_PHOTOMETRIC)) == (4, 2) else NEVER)


def read_tags(head: bytes, file: BinaryIO, at: int | None = None) -> dict[int, float]:
    """The first value of each tag of the table that begins at byte `at`, by default the first picture's.

    A fraction is its quotient, or 0 where it has none.  Raises struct.error on a file that ends before.
    """
    order = "<" if head[:2] == b"II" else ">"
    big = struct.unpack_from(order + "H", head, 2)[0] == 43
    offset, count, entry, number = ("Q", "Q", 20, "Q") if big else ("I", "H", 12, "I")
    file.seek(struct.unpack_from(order + offset, head, 8 if big else 4)[0] if at is None else at)
    (entries,) = struct.unpack(order + count, file.read(struct.calcsize(count)))
    found: dict[int, float] = {}
    for row in [file.read(entry) for _ in range(min(entries, _MOST_TAGS))]:
        tag, kind, values = struct.unpack_from(order + "HH" + number, row)
        code = _CODES.get(kind, number)
        place, inside = row[12:] if big else row[8:], (8 if big else 4) // struct.calcsize(order + code)
        if values > inside:  # they lie elsewhere; the first is enough
            file.seek(struct.unpack(order + number, place)[0])
            place = file.read(8)
        value, *denominator = struct.unpack_from(order + code, place)
        found[tag] = _quotient(value, *denominator)
    return found


def _quotient(value: int, denominator: int = 1) -> float:
    return value if denominator == 1 else value / denominator if denominator else 0.0


TIFF = Format("TIFF", rb"II\*\0|MM\0\*|II\+\0|MM\0\+", _parse)
