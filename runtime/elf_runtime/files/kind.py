"""What a file is, by its first bytes, so that messages can say so."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

HEAD = 512  # bytes that `description` looks at

_SIGNATURES: tuple[tuple[bytes, str], ...] = (
    (b"version https://git-lfs", "a git-lfs pointer in place of the file itself; `git lfs pull` fetches it"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
    (b"\x93NUMPY", "a numpy array (.npy)"),
    (b"PK\x03\x04", "a zip archive (.zip, .npz, .pth, .docx ...)"),
    (b"PK\x05\x06", "an empty zip archive"),
    (b"\x1f\x8b", "a gzip archive; unpack it first"),
    (b"BZh", "a bzip2 archive; unpack it first"),
    (b"\xfd7zXZ", "an xz archive; unpack it first"),
    (b"7z\xbc\xaf'\x1c", "a 7-Zip archive; unpack it first"),
    (b"%PDF", "a PDF document"),
    (b"\x89PNG\r\n\x1a\n", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"GIF8", "a GIF image"),
    (b"II*\0", "a TIFF image"),
    (b"MM\0*", "a TIFF image"),
    (b"\x7fELF", "a program or shared library"),
    (b"MZ", "a Windows program or library"),
    (b"SQLite format 3", "an SQLite database"),
    (b"\x1aE\xdf\xa3", "a Matroska or WebM video"),
)
_BRANDS = {
    b"heic": "a HEIC photograph, which OpenCV can't read; convert it to JPEG",
    b"heix": "a HEIC photograph, which OpenCV can't read; convert it to JPEG",
    b"mif1": "a HEIF image, which OpenCV can't read; convert it to JPEG",
    b"avif": "an AVIF image, which this build of OpenCV may not read",
}


def description(head: bytes, size: int | None = None) -> str | None:
    """What the file is that begins with `head`, such as "a web page (HTML)"; None where it can't be told.

    Parameters
    ----------
    head : bytes
        At least its first `HEAD` bytes, or all of it.
    size : int, optional
        Of the whole file, where `head` is not all of it.
    """
    if (len(head) if size is None else size) == 0:
        return "empty (0 bytes)"
    for signature, what in _SIGNATURES:
        if head.startswith(signature):
            return what
    if head[4:8] == b"ftyp":
        return _BRANDS.get(head[8:12], "an MP4 or QuickTime video")
    if head[:4] == b"RIFF":
        return "a WebP image" if head[8:12] == b"WEBP" else "an AVI video or WAV sound"
    head = head[:HEAD]
    if not any(head):
        return "nothing but zero bytes, as a broken transfer leaves them"
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if text.startswith((b"<!doctype html", b"<html", b"<head")) or b"<html" in text:
        return "a web page (HTML) in place of the file itself; look at it for what the server answered"
    if text.startswith((b"<svg", b"<?xml", b"<")):
        return "an XML document"
    if text.startswith((b"{", b"[")):
        return "JSON text"
    return "text" if _is_text(head) else None


def _is_text(head: bytes) -> bool:
    try:
        decoded = head.decode()
    except UnicodeDecodeError as error:
        if error.start < len(head) - 3:  # not merely cut within a character
            return False
        decoded = head[: error.start].decode()
    return all(character.isprintable() or character in "\t\r\n\f" for character in decoded)


def open_regular(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file for reading.  A pipe or a terminal would block, and a device may never end.

    Raises
    ------
    OSError
        If it can't be opened, or is not a regular file; the text says why.
    """
    # A path with a zero byte is a ValueError of the system's interface.
    if "\0" in os.fsdecode(path):
        raise OSError("embedded null byte in the name")
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        os.scandir(path).close()  # one that can't be listed says why, for it may stand for the files in it
        raise OSError("not a file but a folder")
    if not stat.S_ISREG(mode):
        kinds = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}
        raise OSError(f"not a file but {kinds.get(stat.S_IFMT(mode), 'something else')}")
    return Path(path).open("rb")
