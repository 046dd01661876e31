"""Names of methods that fit where they stand: files without their folders, and long names wrapped."""

from __future__ import annotations

import re
from collections.abc import Sequence


def without_folders(texts: Sequence[str]) -> list[str]:
    """Methods' texts with each file's name in place of its path, unless two of them would become the same.

    ``elf:/data/models/vgg.onnx?preset=paper`` -> ``elf:vgg.onnx?preset=paper``.  Two files of one name keep
    their paths.
    """
    short = [re.sub(r"^(\w+:)(?:[^?]*[/\\])?([^/\\?]+)", r"\1\2", text) for text in texts]
    origins: dict[str, set[str]] = {}
    for name, text in zip(short, texts, strict=True):
        origins.setdefault(name, set()).add(text)
    return [n if len(origins[n]) == 1 else t for n, t in zip(short, texts, strict=True)]


def wrapped(name: str, width: int, lines: int) -> str:
    """`name` in at most `lines` lines of at most `width` characters; what is too long loses its middle.

    Breaks are at spaces and behind ``/ : ? & - _ ,``, and anywhere in a longer word.
    """
    rows: list[str] = []
    for part in name.replace(" + ", "\n+ ").split("\n"):
        breakable = re.sub(r"([/:?&\-_,])", "\\1\0", part)
        row = ""
        for word in re.split("\0|(?<= )", breakable):
            if row and len(row) + len(word.rstrip()) > width:
                rows.append(row.rstrip())
                row = ""
            row += word
            while len(row.rstrip()) > width:
                rows.append(row[:width])
                row = row[width:]
        rows.append(row.rstrip())
    if len(rows) > lines:
        head = max(1, (lines - 1) // 2)
        tail = lines - 1 - head
        rows = [*rows[:head], "...", *(rows[-tail:] if tail else [])]
    return "\n".join(rows)
