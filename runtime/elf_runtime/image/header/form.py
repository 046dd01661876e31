"""What a format of image files is: how it is recognised, how its header is read, and where it ends."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO

NEVER, MAYBE, SURELY = range(3)
MOST_EXIF = 1 << 20  # bytes of EXIF data that are read


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
    alpha: int = NEVER
    transparent: int | None = None
    misread: str = ""


Parser = Callable[[bytes, BinaryIO], Header]


@dataclass(frozen=True)
class Format:
    """A format of image files.

    Attributes
    ----------
    signature : bytes
        A regular expression that its first bytes match.
    parse : function
        Reads the header from the first bytes, and from the file where these are not enough.  On a header that is
        damaged it raises struct.error, ValueError, IndexError or OverflowError.
    ends_early : function, optional
        Whether the bytes of a file end before the format says.
    """

    kind: str
    signature: bytes
    parse: Parser
    ends_early: Callable[[bytes], bool] | None = None


def two_numbers(kind: str, form: str, at: int, alpha: int) -> Parser:
    """Of formats whose width and height have a place of their own, in `struct`'s format `form`."""

    def parse(head: bytes, _: BinaryIO) -> Header:
        width, height = struct.unpack_from(form, head, at)
        return Header(kind, width, height, alpha)

    return parse
