"""Images that fsspec reaches: s3://bucket/photos/1.jpg, gs://, http://, ...  Needs fsspec."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from elf_runtime.errors import ElfError, ImageError, reason
from elf_runtime.files.listing import shut_on_the_way
from elf_runtime.image.file import ImageFile

from .frames import Unreadable
from .store import file_system, is_object_store, protocols, storage_errors


@dataclass(frozen=True)
class Remote:
    """An image by its URL.  It can be pickled, with what fsspec needs to reach it.

    Attributes
    ----------
    stem : Path
        Its name among the results.
    """

    name: str
    stem: Path
    system: Any
    path: str

    def told(self) -> dict[str, Any]:
        return {"image": self.name}

    identity = told

    def open(self, max_pixels: int | None) -> ImageFile:
        """Fetch it.  Raises ImageError."""
        try:
            with storage_errors(self.name):
                data = self.system.cat_file(self.path)
        except ElfError as error:
            raise ImageError(str(error)) from error
        return ImageFile(self.name, max_pixels, bytes(data))


def remote_images(
    url: str, recursive: bool, suffixes: Collection[str], base: str | None = None
) -> list[Remote | Unreadable]:
    """The image of a URL, those of a folder, or what a pattern matches, sorted.

    Parameters
    ----------
    recursive : bool
        Of a folder, those in its subfolders too; nothing hidden.
    suffixes : collection of str
        Of the images of a folder, lower case.
    base : str, optional
        Images are named by what is below this URL: by default below the folder, else by the file's name; those of an
        archive (``zip://folder::s3://bucket/a.zip``) with its name before that.

    Returns
    -------
    list of Remote
        Empty where a folder or a pattern has none.  A URL that is named alone need not exist.  At the end, as
        Unreadable, folders that can't be listed.

    Raises
    ------
    ElfError
        If fsspec can't list it, or an image is not below `base`.
    """
    system, root = file_system(url)
    root = root.rstrip("/") or root
    address = _Address.of(url, system, root)
    with storage_errors(url):
        paths, folder, shut = _found(system, root, recursive, suffixes)
    below = folder if base is None else file_system(base)[1]

    def stem_of(path: str) -> Path:
        inside = PurePosixPath(path)
        place = str(inside.parent) if below is None else below
        if not inside.is_relative_to(place):
            raise ElfError(f"--base {base}: {address.of_path(path)} is not below it")
        return Path("" if base else address.archive, inside.relative_to(place))

    images = [Remote(address.of_path(path), stem_of(path), system, path) for path in sorted(paths)]
    lost = [(address.of_path(path), stem_of(path), why) for path, why in sorted(shut.items())]
    return [*images, *(Unreadable(name, stem, ElfError(f"{name}: {why}")) for name, stem, why in lost)]


@dataclass(frozen=True)
class _Address:
    """How the paths of a file system are written as URLs that say which one it is: its host, its archive.

    Attributes
    ----------
    start : str, optional
        Before the path; None where only fsspec knows.
    end : str
        After it: ``::s3://bucket/a.zip``.
    """

    system: Any
    start: str | None
    end: str

    @classmethod
    def of(cls, url: str, system: Any, root: str) -> _Address:
        """Of a URL whose path in the system is `root`.  fsspec's own URL has no more than scheme and path."""
        links = url.split("::")
        scheme = system.unstrip_protocol(root).partition("://")[0]
        at = next((index for index, link in enumerate(links) if link.partition("://")[0] == scheme), 0)
        link = links[at].rstrip("/") if root else links[at]
        start = link.removesuffix(root)
        # What is before an @ may be a password.
        known = link.endswith(root) and "@" not in start and ("://" in start or not start)
        return cls(system, start if known else None, "".join(f"::{link}" for link in links[at + 1 :]))

    @property
    def archive(self) -> str:
        """The file name of what the file system is in; empty where it is in none."""
        return self.end.removeprefix("::").partition("::")[0].rstrip("/").rpartition("/")[2]

    def of_path(self, path: str) -> str:
        return (str(self.system.unstrip_protocol(path)) if self.start is None else self.start + path) + self.end


def _found(
    system: Any, root: str, recursive: bool, suffixes: Collection[str]
) -> tuple[list[str], str | None, dict[str, str]]:
    """The images of a path; the folder that it is, if it is one; and the folders that can't be listed -> why."""
    system.invalidate_cache()
    # A name that exists comes before a pattern, which matches files and folders.
    if any(sign in root for sign in "*?[") and not system.exists(root):
        matched = system.glob(root, detail=True)
        ways = shut_on_the_way(root) if "file" in protocols(system) else ()
        paths = [path for path, info in matched.items() if info.get("type") != "directory"]
        return paths, None, {folder.as_posix(): "it can't be listed" for folder in ways}
    if not system.isdir(root):
        return [root], None, {}
    listed, shut = _listed(system, root, recursive)
    paths = [path for path in listed if _shown(path, root) and PurePosixPath(path).suffix.lower() in suffixes]
    return paths, root, shut


def _listed(system: Any, folder: str, recursive: bool) -> tuple[list[str], dict[str, str]]:
    """The files in a folder, or also below it though not through links; and the folders that can't be listed -> why."""
    if is_object_store(system):  # quicker there, where folders are parts of names
        return list(system.find(folder, maxdepth=None if recursive else 1)), {}
    files: list[str] = []
    shut: dict[str, str] = {}
    waiting = [folder]
    while waiting:
        place = waiting.pop()
        try:
            entries = system.ls(place, detail=True)
        except OSError as error:
            shut[place] = reason(error) or type(error).__name__
            continue
        for entry in entries:
            path = str(entry["name"]).rstrip("/")
            if entry.get("islink") or entry.get("type") == "file":
                files.append(path)
            elif entry.get("type") == "directory" and recursive and _is_inside(path, place):
                waiting.append(path)
    return files, shut


def _is_inside(path: str, place: str) -> bool:
    return path != place and PurePosixPath(path).is_relative_to(place) and _shown(path, place)


def _shown(path: str, root: str) -> bool:
    return not any(part.startswith(".") for part in PurePosixPath(path).relative_to(root).parts)
