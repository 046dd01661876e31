"""Images that fsspec reaches: s3://bucket/photos/1.jpg, gs://, http://, ...  Needs fsspec."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from elf_runtime.errors import ElfError, ImageError
from elf_runtime.image.file import ImageFile

from .store import file_system, storage_errors


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


def remote_images(url: str, recursive: bool, suffixes: Collection[str], base: str | None = None) -> list[Remote]:
    """The image of a URL, those of a folder, or what a pattern matches, sorted.

    Parameters
    ----------
    recursive : bool
        Of a folder, those in its subfolders too; nothing hidden.
    suffixes : collection of str
        Of the images of a folder, lower case.
    base : str, optional
        Images are named by what is below this URL: by default below the folder, else by the file's name.

    Returns
    -------
    list of Remote
        Empty where a folder or a pattern has none.  A URL that is named alone need not exist.

    Raises
    ------
    ElfError
        If fsspec can't list it, or an image is not below `base`.
    """
    system, root = file_system(url)
    root = root.rstrip("/") or root
    with storage_errors(url):
        system.invalidate_cache()
        if any(sign in root for sign in "*?["):
            # A pattern matches files and folders.
            matched = system.glob(root, detail=True)
            paths = sorted(path for path, info in matched.items() if info.get("type") != "directory")
            folder = None
        elif system.isdir(root):
            listed = system.find(root, maxdepth=None if recursive else 1)
            paths = sorted(
                path for path in listed if _shown(path, root) and PurePosixPath(path).suffix.lower() in suffixes
            )
            folder = root
        else:
            paths, folder = [root], None
    below = None if base is None else file_system(base)[1]
    return [_image(system, path, below or folder or str(PurePosixPath(path).parent), base) for path in paths]


def _image(system: Any, path: str, folder: str, base: str | None) -> Remote:
    inside, place = PurePosixPath(path), PurePosixPath(folder)
    url = system.unstrip_protocol(path)
    if not inside.is_relative_to(place):
        raise ElfError(f"--base {base}: {url} is not below it")
    return Remote(url, Path(inside.relative_to(place)), system, path)


def _shown(path: str, root: str) -> bool:
    return not any(part.startswith(".") for part in PurePosixPath(path).relative_to(root).parts)
