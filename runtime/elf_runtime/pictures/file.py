"""Pictures as files."""

from __future__ import annotations

from pathlib import Path

import cv2

from elf_runtime.errors import ElfError
from elf_runtime.files.write import write_atomically

from .canvas import Picture


def short_name(path: str | Path) -> str:
    """A file's name with its folder's, for titles: what tells ``graf/1.png`` from ``wall/1.png``."""
    return "/".join(Path(path).parts[-2:])


def write_picture(path: Path, picture: Picture) -> None:
    """Write an image file; the ending says which kind.

    Raises
    ------
    ElfError
        If OpenCV knows no such kind.
    """
    try:
        done, data = cv2.imencode(path.suffix, picture)
    except cv2.error:
        done = False
    if not done:
        raise ElfError(f"{path}: can't write an image with the ending {path.suffix!r}; use .png or .jpg")
    write_atomically(path, lambda temporary: temporary.write_bytes(data.tobytes()))
