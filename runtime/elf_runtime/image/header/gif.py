"""GIF: images and extensions, each a row of blocks, up to a trailer."""

from __future__ import annotations

from .form import MAYBE, Format, two_numbers

_IMAGE, _TRAILER = 0x2C, 0x3B


def _ends_early(data: bytes) -> bool:
    at = 13 + _colors(data[10])
    while data[at] != _TRAILER:
        if data[at] == _IMAGE:  # its place and colours, then blocks; else an extension: a label, then blocks
            at += 9 + _colors(data[at + 9])
        at += 2
        while data[at]:
            at += 1 + data[at]
        at += 1
    return False


def _colors(flags: int) -> int:
    """Bytes of the colour table that the flags announce."""
    return 3 << (flags & 7) + 1 if flags & 0x80 else 0


GIF = Format("GIF", rb"GIF8[79]a", two_numbers("GIF", "<HH", 6, MAYBE), _ends_early)
