"""Kind, size and completeness of an image file, read from its header before anything is decoded.

A picture of a megabyte may unpack to gigabytes, and a decoder allocates them before it looks at the data.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, BinaryIO

NEVER, MAYBE, SURELY = range(3)
_Sides = tuple[Any, ...]  # width, height, alpha, and what else there is
_Parser = Callable[[bytes, BinaryIO], _Sides]

_HEAD = 1 << 16  # bytes in which all formats but JPEG and TIFF say their size


@dataclass(frozen=True)
class Header:
    """What an image file says of itself.

    Attributes
    ----------
    kind : str
        "PNG", "JPEG" ...
    width, height : int
        In pixels, as stored; 0 where the header does not say.
    alpha : NEVER, MAYBE or SURELY
        Whether its pixels have an alpha channel.
    transparent : int, optional
        Of a grey picture without one, the pixel value that stands for no image.
    misread : str
        What OpenCV decodes to other pixels than the file's, if it is that.
    """

    kind: str
    width: int = 0
    height: int = 0
    alpha: int = 0
    transparent: int | None = None
    misread: str = ""


def read_header(file: BinaryIO) -> Header | None:
    """The header of an image file that is open at its beginning; None where no kind of image is recognised."""
    head = file.read(_HEAD)
    for signature, kind, parse in _KINDS:
        if re.match(signature, head, re.DOTALL):
            try:
                return Header(kind, *parse(head, file))
            except (struct.error, ValueError, IndexError, OverflowError):
                return Header(kind)
    return None


def is_cut_off(data: bytes, header: Header) -> bool:
    """Whether an image file ends before its format says that it does; False for formats that don't say."""
    try:
        if header.kind == "JPEG":
            return data.find(b"\xff\xd9", _scan(data)) < 0  # thumbnails, which have such an end too, lie before
        if header.kind == "PNG":
            return _png_ends_early(data)
        if header.kind == "WebP":
            return len(data) < int.from_bytes(data[4:8], "little") + 8
        if header.kind == "BMP":
            return len(data) < int.from_bytes(data[2:6], "little")
        if header.kind == "GIF":
            return _gif_ends_early(data)
    except (struct.error, IndexError):
        return True
    return False


def _png(head: bytes, file: BinaryIO) -> _Sides:
    width, height, depth, color = struct.unpack_from(">IIBB", head, 16)
    at, key = 8, None
    while True:  # chunk by chunk: profiles and comments of any length may stand before the transparency
        file.seek(at)
        chunk = file.read(10)
        if len(chunk) < 8 or chunk[4:8] in (b"IDAT", b"IEND"):
            break
        if chunk[4:8] == b"tRNS":
            if color == 0 and len(chunk) == 10:
                key = int.from_bytes(chunk[8:], "big") * (255 // ((1 << depth) - 1) if depth < 8 else 1)
            return width, height, SURELY, key
        at += 12 + int.from_bytes(chunk[:4], "big")
    return width, height, SURELY if color in (4, 6) else NEVER


def _png_ends_early(data: bytes) -> bool:
    at = 8
    while True:
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        at += length + 12
        if kind == b"IEND" or at > len(data):
            return at > len(data)


def _gif_ends_early(data: bytes) -> bool:
    at = 13 + _gif_colors(data[10])
    while data[at] != 0x3B:
        if data[at] == 0x2C:  # an image: its place and colours, then blocks; else an extension: a label, then blocks
            at += 9 + _gif_colors(data[at + 9])
        at += 2
        while data[at]:
            at += 1 + data[at]
        at += 1
    return False


def _gif_colors(flags: int) -> int:
    """Bytes of the colour table that the flags announce."""
    return 3 << (flags & 7) + 1 if flags & 0x80 else 0


def _jpeg(_: bytes, file: BinaryIO) -> _Sides:
    """By the frame header, which may lie behind megabytes of metadata."""
    at = 2
    while True:
        file.seek(at)
        segment = file.read(9)
        if len(segment) < 4 or segment[0] != 0xFF:
            return 0, 0, NEVER
        marker = segment[1]
        if marker == 0xFF or 0xD0 <= marker <= 0xD8 or marker == 0x01:  # padding, or without a length
            at += 1 if marker == 0xFF else 2
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", segment, 5)
            return width, height, NEVER
        if marker in (0xD9, 0xDA):
            return 0, 0, NEVER
        at += 2 + max(2, struct.unpack_from(">H", segment, 2)[0])


def _scan(data: bytes) -> int:
    """Where a JPEG's compressed pixels begin; its end where there are none."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xDA:
            return at
        if marker == 0xFF:
            at += 1
        elif 0xD0 <= marker <= 0xD8 or marker == 0x01:
            at += 2
        else:
            at += 2 + max(2, struct.unpack_from(">H", data, at + 2)[0])
    return len(data)


def _webp(head: bytes, _: BinaryIO) -> _Sides:
    form = head[12:16]
    if form == b"VP8X":
        width, height = (int.from_bytes(head[at : at + 3], "little") + 1 for at in (24, 27))
        return width, height, SURELY if head[20] & 0x10 else NEVER
    if form == b"VP8L":
        (bits,) = struct.unpack_from("<I", head, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1, MAYBE if bits >> 28 & 1 else NEVER
    width, height = struct.unpack_from("<HH", head, 26)
    return width & 0x3FFF, height & 0x3FFF, NEVER


def _bmp(head: bytes, _: BinaryIO) -> _Sides:
    if struct.unpack_from("<I", head, 14)[0] == 12:
        width, height = struct.unpack_from("<HH", head, 18)
        return width, height, NEVER
    width, height, _planes, bits = struct.unpack_from("<iiHH", head, 18)
    return abs(width), abs(height), MAYBE if bits == 32 else NEVER


def _tiff(head: bytes, file: BinaryIO) -> _Sides:
    order = "<" if head[:2] == b"II" else ">"
    big = struct.unpack_from(order + "H", head, 2)[0] == 43
    offset, count, entry, number = ("Q", "Q", 20, "Q") if big else ("I", "H", 12, "I")
    file.seek(struct.unpack_from(order + offset, head, 8 if big else 4)[0])
    (entries,) = struct.unpack(order + count, file.read(struct.calcsize(count)))
    found: dict[int, int] = {}
    for row in [file.read(entry) for _ in range(min(entries, 4096))]:
        tag, kind, values = struct.unpack_from(order + "HH" + number, row)
        code = {1: "B", 3: "H", 4: "I", 16: "Q"}.get(kind, number)
        place, inside = row[12:] if big else row[8:], (8 if big else 4) // struct.calcsize(code)
        if values > inside:  # they lie elsewhere; the first is enough
            file.seek(struct.unpack(order + number, place)[0])
            place = file.read(8)
        found[tag] = struct.unpack_from(order + code, place)[0]
    width, height = found.get(256, 0), found.get(257, 0)
    if found.get(284) == 2 and found.get(277, 1) > 1 and found.get(258, 8) != 8:
        return width, height, NEVER, None, f"a planar TIFF of {found[258]} bits"
    if 338 in found:  # ExtraSamples: 1 and 2 are alpha, 0 is anything else, such as infrared
        return width, height, SURELY if found[338] in (1, 2) else NEVER
    # OpenCV itself writes four channels of an RGB picture without saying what the fourth is.
    return width, height, MAYBE if (found.get(277, 1), found.get(262)) == (4, 2) else NEVER


def _text(pattern: bytes) -> _Parser:
    def parse(head: bytes, _: BinaryIO) -> _Sides:
        found = re.search(pattern, re.sub(rb"#[^?\n][^\n]*\n", b"\n", head))
        return (int(found["w"]), int(found["h"]), NEVER) if found else (0, 0, NEVER)

    return parse


def _pam(head: bytes, _: BinaryIO) -> _Sides:
    stated = dict(re.findall(rb"^(WIDTH|HEIGHT|DEPTH)\s+(\d{1,12})", head.partition(b"ENDHDR")[0], re.MULTILINE))
    width, height, depth = (int(stated.get(name, 0)) for name in (b"WIDTH", b"HEIGHT", b"DEPTH"))
    return width, height, NEVER, None, "a PAM picture with alpha" if depth in (2, 4) else ""


def _jp2(head: bytes, _: BinaryIO) -> _Sides:
    at = head.find(b"ihdr")
    if at >= 0:
        height, width, channels = struct.unpack_from(">IIH", head, at + 4)
        return width, height, {2: SURELY, 4: MAYBE}.get(channels, NEVER)
    right, bottom, left, top = struct.unpack_from(">IIII", head, head.find(b"\xff\x51") + 6)
    return right - left, bottom - top, MAYBE


def _heif(head: bytes, _: BinaryIO) -> _Sides:
    sides = [struct.unpack_from(">II", head, found.end() + 4) for found in re.finditer(b"ispe", head)]
    width, height = max(sides, key=lambda size: size[0] * size[1], default=(0, 0))
    return width, height, MAYBE


def _fixed(form: str, at: int, alpha: int) -> _Parser:
    """Two numbers of `struct`'s format `form` at a place of their own."""

    def parse(head: bytes, _: BinaryIO) -> _Sides:
        width, height = struct.unpack_from(form, head, at)
        return width, height, alpha

    return parse


def _exr(head: bytes, _: BinaryIO) -> _Sides:
    at = head.index(b"dataWindow\0box2i\0") + 17 + 4
    left, top, right, bottom = struct.unpack_from("<iiii", head, at)
    return abs(right - left) + 1, abs(bottom - top) + 1, MAYBE


_KINDS: tuple[tuple[bytes, str, _Parser], ...] = (
    (rb"\x89PNG\r\n\x1a\n", "PNG", _png),
    (rb"\xff\xd8\xff", "JPEG", _jpeg),
    (rb"RIFF....WEBP", "WebP", _webp),
    (rb"BM", "BMP", _bmp),
    (rb"II\*\0|MM\0\*|II\+\0|MM\0\+", "TIFF", _tiff),
    (rb"GIF8[79]a", "GIF", _fixed("<HH", 6, MAYBE)),
    (rb"P[1-6]\s", "PNM", _text(rb"^P[1-6]\s+(?P<w>\d{1,12})\s+(?P<h>\d{1,12})")),
    (rb"P7\s", "PAM", _pam),
    (rb"P[Ff]\s", "PFM", _text(rb"^P[Ff]\s+(?P<w>\d{1,12})\s+(?P<h>\d{1,12})")),
    (rb"#\?R", "HDR", _text(rb"[-+]Y\s+(?P<h>\d{1,12})\s+[-+]X\s+(?P<w>\d{1,12})")),
    (rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51", "JPEG 2000", _jp2),
    (rb"....ftyp(avif|avis|heic|heix|mif1|msf1)", "AVIF or HEIF", _heif),
    (rb"\x76\x2f\x31\x01", "OpenEXR", _exr),
    (rb"\x59\xa6\x6a\x95", "Sun raster", _fixed(">II", 4, NEVER)),
)
