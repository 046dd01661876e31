"""Formats whose header is text: PNM, PAM and PFM, and Radiance's HDR."""

from __future__ import annotations

import re
from typing import BinaryIO

from .form import Format, Header, Parser


def _sides(kind: str, pattern: bytes) -> Parser:
    """Width and height as the groups w and h of a pattern; comments are left out."""

    def parse(head: bytes, _: BinaryIO) -> Header:
        found = re.search(pattern, re.sub(rb"#[^?\n][^\n]*\n", b"\n", head))
        return Header(kind, int(found["w"]), int(found["h"])) if found else Header(kind)

    return parse


def _pam(head: bytes, _: BinaryIO) -> Header:
    stated = dict(re.findall(rb"^(WIDTH|HEIGHT|DEPTH)\s+(\d{1,12})", head.partition(b"ENDHDR")[0], re.MULTILINE))
    width, height, depth = (int(stated.get(name, 0)) for name in (b"WIDTH", b"HEIGHT", b"DEPTH"))
    return Header("PAM", width, height, misread="a PAM picture with alpha" if depth in (2, 4) else "")


PNM = Format("PNM", rb"P[1-6]\s", _sides("PNM", rb"^P[1-6]\s+(?P<w>\d{1,12})\s+(?P<h>\d{1,12})"))
PAM = Format("PAM", rb"P7\s", _pam)
PFM = Format("PFM", rb"P[Ff]\s", _sides("PFM", rb"^P[Ff]\s+(?P<w>\d{1,12})\s+(?P<h>\d{1,12})"))
HDR = Format("HDR", rb"#\?R", _sides("HDR", rb"[-+]Y\s+(?P<h>\d{1,12})\s+[-+]X\s+(?P<w>\d{1,12})"))
