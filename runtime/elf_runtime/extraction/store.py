"""A folder of shards, local or wherever fsspec reaches: s3://, gs://, ...  Needs fsspec.

A shard is there whole or not at all, and one that is written again replaces the first.
"""

from __future__ import annotations

import re
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from elf_runtime.errors import ElfError, first_line

SHARD = re.compile(r"part-(\d{4,})-[0-9a-f]{12}-\d{5,}\.(parquet|h5)")  # the number of its run in this folder first
# In these a file appears when all of it is there, and a renaming would be a second copy.
OBJECT_STORES = frozenset(("s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oci", "oss", "r2"))


def needed(module: str, extra: str = "ray") -> Any:
    """A module that an extra installs.

    Raises
    ------
    ElfError
        If it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = "ray[data]" if module.startswith("ray") else module.partition(".")[0]
        raise ElfError(
            f"work on many machines and its shards need {package}, which can't be imported ({first_line(error)}): "
            f"pip install 'elf-onnx[{extra}]'"
        ) from None


def is_url(place: object) -> bool:
    """Whether it is fsspec's to open, such as ``s3://bucket/folder``."""
    return isinstance(place, str) and re.match(r"[A-Za-z][\w+.-]*:(//|:)", place) is not None


def file_system(place: str) -> tuple[Any, str]:
    """fsspec's file system of a place, and the path in it.

    Raises
    ------
    ElfError
        If fsspec does not know it, or lacks the package that it needs for it.
    """
    core = needed("fsspec.core")
    try:
        system, path = core.url_to_fs(place)
    except Exception as error:  # what the many file systems raise has no common base
        raise ElfError(f"{place}: {first_line(error)}") from error
    return system, str(path)


@contextmanager
def storage_errors(place: str) -> Iterator[None]:
    """Say what a file system refuses as an ElfError that begins with the place."""
    try:
        yield
    except ElfError:
        raise
    except Exception as error:  # as above
        text = f"{type(error).__name__}: {first_line(error)}" if str(error).strip() else type(error).__name__
        raise ElfError(f"{place}: {text}") from error


def run_of(shard: str) -> int:
    """The number of the run that wrote a shard, by its name: a later run has a higher one, whatever clocks say."""
    found = SHARD.fullmatch(shard)
    return int(found[1]) if found else 0


@dataclass(frozen=True)
class Store:
    """A folder by its place, for messages, with its file system and path in it.  It can be pickled."""

    place: str
    system: Any
    path: str

    @classmethod
    def at(cls, place: str) -> Store:
        system, path = file_system(place)
        return cls(place.rstrip("/") or place, system, path.rstrip("/") or path)

    def url(self, name: str) -> str:
        return f"{self.place}/{name}"

    def names(self) -> list[str]:
        """Of its files and folders, sorted; none where there is no such folder."""
        with storage_errors(self.place):
            self.system.invalidate_cache()
            with suppress(FileNotFoundError, NotADirectoryError):
                found = self.system.ls(self.path, detail=False)
                return sorted(str(path).rstrip("/").rpartition("/")[2] for path in found)
        return []

    def shards(self) -> list[str]:
        """The names of its shards: those of the newest run first, and each run's in order."""
        return sorted((name for name in self.names() if SHARD.fullmatch(name)), key=lambda name: (-run_of(name), name))

    def put(self, file: Path, name: str) -> None:
        """Take a local file in as `name`, whole or not at all, in place of what is there."""
        with storage_errors(self.url(name)):
            self.system.makedirs(self.path, exist_ok=True)
            if is_object_store(self.system):
                self.system.put_file(str(file), f"{self.path}/{name}")
                return
            part = f"{self.path}/.{name}.{secrets.token_hex(8)}.part"
            try:
                self.system.put_file(str(file), part)
                self.system.mv(part, f"{self.path}/{name}")
            except BaseException:
                with suppress(Exception):
                    self.system.rm_file(part)
                raise

    def put_text(self, text: str, name: str) -> None:
        with tempfile.TemporaryDirectory(prefix="elf-") as folder:
            file = Path(folder, "text")
            file.write_text(text, encoding="utf-8")
            self.put(file, name)

    def text(self, name: str) -> str | None:
        """What a file holds; None where there is none."""
        with storage_errors(self.url(name)):
            try:
                return bytes(self.system.cat_file(f"{self.path}/{name}")).decode()
            except FileNotFoundError:
                return None

    def remove(self, name: str) -> None:
        """Remove a file, which may be gone already."""
        with storage_errors(self.url(name)), suppress(FileNotFoundError):
            self.system.rm_file(f"{self.path}/{name}")

    @contextmanager
    def opened(self, name: str) -> Iterator[Any]:
        """A file for reading, of which only what is asked for is fetched."""
        with storage_errors(self.url(name)), self.system.open(f"{self.path}/{name}", "rb") as file:
            yield file

    @contextmanager
    def fetched(self, name: str) -> Iterator[Path]:
        """A file as a local one, a copy where it is not."""
        if "file" in protocols(self.system):
            yield Path(self.path, name)
            return
        with tempfile.TemporaryDirectory(prefix="elf-") as folder:
            with storage_errors(self.url(name)):
                self.system.get_file(f"{self.path}/{name}", f"{folder}/{name}")
            yield Path(folder, name)


def is_object_store(system: Any) -> bool:
    return not OBJECT_STORES.isdisjoint(protocols(system))


def protocols(system: Any) -> tuple[str, ...]:
    """The schemes of its URLs."""
    names = system.protocol
    return (names,) if isinstance(names, str) else tuple(names)
