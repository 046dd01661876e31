"""Shards: files of the features of many images each, as ``elf-detect --engine ray`` writes them.

A shard is a table of Parquet, see `parquet`, or one of hloc's features.h5 whose groups have the record as an attribute.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Collection, Iterator, Mapping, Set
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from elf_runtime.errors import ElfError, first_line
from elf_runtime.results.features import Features
from elf_runtime.results.hloc import read_features, write_features

from .parquet import parquet_records, read_parquet, write_parquet
from .store import Store, needed

FORMATS = ("parquet", "h5")
_PARQUET, _HDF5 = b"PAR1", b"\x89HDF\r\n\x1a\n"  # how the files begin; one of Parquet ends so, too


def read_shards(path: str | os.PathLike[str]) -> Iterator[tuple[str, Features]]:
    """The features of all images in a folder of shards, each image once, or in one of them.

    A run that was stopped leaves older rows beside its own; of an image's rows that of the newest run is given.

    Parameters
    ----------
    path : path or URL
        The output of ``elf-detect --engine ray``, or a shard; a URL is one that fsspec knows (``s3://``, ``gs://``).

    Yields
    ------
    (name, Features)
        By shard and in its order, the newest run's shards first; the record says which image, model and settings.  One
        shard at most is in memory.

    Raises
    ------
    ElfError
        If fsspec, and pyarrow or h5py, are not installed (extras ``ray``, ``h5``); if there are no
        shards, or one is damaged.
    """
    place = os.fspath(path).rstrip("/")
    folder, _, name = place.rpartition("/")
    if name.rpartition(".")[2] in FORMATS:
        store, names = Store.at(folder or ("/" if place.startswith("/") else ".")), [name]
    else:
        store = Store.at(place)
        names = store.shards()
    if not names:
        raise ElfError(f"{place}: no shards of elf-detect there")
    given: set[str] = set()
    for shard in names:
        with store.fetched(shard) as file:
            for image, features in read_shard(file):
                if image not in given:
                    given.add(image)
                    yield image, features


def write_shard(store: Store, name: str, rows: Mapping[str, Features]) -> None:
    """Write name -> features, with their records, as a shard whose ending says the format; whole or not at all."""
    with tempfile.TemporaryDirectory(prefix="elf-") as folder:
        file = Path(folder, name)
        if file.suffix == ".parquet":
            write_parquet(file, rows)
        else:
            write_features(file, rows)
            with needed("h5py", "h5").File(file, "r+") as groups:
                for row, features in rows.items():
                    groups[row].attrs["record"] = json.dumps(dict(features.record or {}), sort_keys=True)
        store.put(file, name)


def read_shard(file: Path) -> Iterator[tuple[str, Features]]:
    """The names and features of one local file.  Raises ElfError where it is damaged."""
    if file.suffix == ".parquet":
        yield from read_parquet(file)
        return
    found = read_features(file)
    with file.open("rb") as opened:
        records = dict(_records(opened, file.name))
    for name, features in found.items():
        yield name, replace(features, record=records.get(name))


def torn_shards(store: Store) -> list[str]:
    """Those that were cut off, by a disk that was full or a machine that failed; what is no shard is not among them."""
    return [shard for shard in store.shards() if _is_torn(store, shard)]


def contents(store: Store, but: Collection[str] = ()) -> dict[str, dict[str, str]]:
    """Name of an image -> the shards that have it, `but` these, each with the `digest` of its record there."""
    found: dict[str, dict[str, str]] = {}
    for shard in store.shards():
        if shard in but:
            continue
        with store.opened(shard) as file:
            for name, record in _records(file, shard):
                found.setdefault(name, {})[shard] = digest(record)
    return found


def without(store: Store, shard: str, names: Set[str]) -> None:
    """Write a shard anew without some of its images, or remove it where there are no others."""
    with store.fetched(shard) as file:
        kept = {name: features for name, features in read_shard(file) if name not in names}
    if kept:
        write_shard(store, shard, kept)
    else:
        store.remove(shard)


def digest(data: Any) -> str:
    """The same for the same plain data: 32 hexadecimal digits."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:32]


def _is_torn(store: Store, shard: str) -> bool:
    """Whether it begins as a shard does, and does not end so."""
    with store.opened(shard) as file:
        head = file.read(len(_HDF5))
        if shard.endswith(".parquet"):
            file.seek(0, os.SEEK_END)
            size = file.tell()
            file.seek(max(0, size - len(_PARQUET)))
            is_whole = size > 2 * len(_PARQUET) and file.read() == _PARQUET
            return not is_whole and _PARQUET.startswith(head[: len(_PARQUET)])
        if head != _HDF5:
            return _HDF5.startswith(head)
        try:
            needed("h5py", "h5").File(file, "r").close()
        except OSError as error:
            return "truncated" in str(error)
    return False


def _records(file: BinaryIO, shard: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """The names and records of an open shard, without the features."""
    if shard.endswith(".parquet"):
        yield from parquet_records(file, shard)
        return
    names: list[tuple[str, dict[str, Any]]] = []

    def visit(name: str, group: Any) -> None:
        if "record" in group.attrs:
            names.append((name, json.loads(group.attrs["record"])))

    try:
        with needed("h5py", "h5").File(file, "r") as groups:
            groups.visititems(visit)
    except (LookupError, OSError, TypeError, ValueError) as error:
        raise ElfError(f"{shard}: not a shard of features: {first_line(error)}") from error
    yield from names
