"""TensorFlow's checkpoints, without TensorFlow: ``NAME.index`` and ``NAME.data-00000-of-00001``.

The index is a sorted table of LevelDB's form, without compression: blocks of keys that leave out what they share with
the key before, then a footer that says where the index of the blocks lies.  A value is a protocol buffer: type, shape,
and where the tensor's bytes lie in which data file.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_export.errors import WeightsError

Array = npt.NDArray[Any]

FOOTER = 48  # bytes
_MAGIC = (0xDB4775248B80FB57).to_bytes(8, "little")
# Of TensorFlow's DataType what weights have: DT_FLOAT, DT_DOUBLE, DT_INT32, DT_INT64, DT_HALF.
_TYPES = {1: "<f4", 2: "<f8", 3: "<i4", 9: "<i8", 19: "<f2"}
_BLOCK_END = 5  # bytes behind a block: its compression, and a checksum
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5  # kinds of a protocol buffer's fields


def is_index(path: Path) -> bool:
    """Whether a file ends as a checkpoint's index does."""
    with open(path, "rb") as file:
        file.seek(0, 2)
        if file.tell() < FOOTER:
            return False
        file.seek(-len(_MAGIC), 2)
        return file.read() == _MAGIC


def read_checkpoint(path: Path) -> dict[str, Array]:
    """The tensors of numbers, by the variables' names.

    Raises
    ------
    WeightsError
        If the index is damaged or compressed, or a data file is missing or too short.
    """
    data = path.read_bytes()
    shards: dict[int, bytes] = {}
    count, tensors = 1, {}
    try:
        for key, value in _entries(data):
            fields = dict(_fields(value))
            if not key:  # the header, which comes first
                count = fields.get(1, 1)
            elif fields.get(1) in _TYPES and 7 not in fields:  # 7: a variable in slices
                shard = fields.get(3, 0)
                if shard not in shards:
                    shards[shard] = _shard(path, shard, count)
                tensors[key.decode()] = _tensor(key.decode(), fields, shards[shard], path)
    except (IndexError, UnicodeDecodeError, TypeError) as error:
        raise WeightsError(f"{path}: a TensorFlow checkpoint's index that is damaged") from error
    return tensors


def _shard(path: Path, number: int, count: int) -> bytes:
    file = path.with_name(f"{path.name.removesuffix('.index')}.data-{number:05d}-of-{count:05d}")
    if not file.is_file():
        raise WeightsError(f"{file}: no such file; a TensorFlow checkpoint's tensors lie in it, beside {path.name}")
    return file.read_bytes()


def _tensor(name: str, fields: dict[int, Any], data: bytes, path: Path) -> Array:
    shape = [size for key, dim in _fields(fields.get(2, b"")) if key == 2 for size in [dict(_fields(dim)).get(1, 0)]]
    kind = np.dtype(_TYPES[fields[1]])
    begin, length = fields.get(4, 0), fields.get(5, 0)
    wanted = kind.itemsize * int(np.prod(shape, dtype=np.int64))
    if length != wanted or begin + length > len(data):
        raise WeightsError(f"{path}: {name}: its data file ends before it, or is another checkpoint's")
    return np.frombuffer(data[begin : begin + length], kind).reshape(shape).astype(kind.newbyteorder("="))


def _entries(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """All keys and values of a table."""
    footer = data[-FOOTER:]
    _, place = _varint(footer, 0)  # where the block of metadata lies
    _, place = _varint(footer, place)
    begin, place = _varint(footer, place)
    length, _ = _varint(footer, place)
    for _, handle in _block(data, begin, length):
        begin, place = _varint(handle, 0)
        length, _ = _varint(handle, place)
        yield from _block(data, begin, length)


def _block(data: bytes, begin: int, length: int) -> Iterator[tuple[bytes, bytes]]:
    if data[begin + length] != 0 or begin + length + _BLOCK_END > len(data):
        raise IndexError("a compressed block, or one that reaches out of the file")
    block = data[begin : begin + length]
    restarts = int.from_bytes(block[-4:], "little")
    end, place, key = length - 4 * (restarts + 1), 0, b""
    while place < end:
        shared, place = _varint(block, place)
        own, place = _varint(block, place)
        size, place = _varint(block, place)
        key = key[:shared] + block[place : place + own]
        yield key, block[place + own : place + own + size]
        place += own + size


def _fields(message: bytes) -> Iterator[tuple[int, Any]]:
    """The fields of a protocol buffer: numbers and bytes."""
    place = 0
    while place < len(message):
        tag, place = _varint(message, place)
        kind = tag & 7
        if kind == _VARINT:
            value, place = _varint(message, place)
            yield tag >> 3, value
        elif kind in (_FIXED64, _FIXED32):
            size = 8 if kind == _FIXED64 else 4
            yield tag >> 3, int.from_bytes(message[place : place + size], "little")
            place += size
        elif kind == _BYTES:
            size, place = _varint(message, place)
            yield tag >> 3, message[place : place + size]
            place += size
        else:
            raise IndexError(f"a field of kind {kind}")


def _varint(data: bytes, place: int) -> tuple[int, int]:
    """A number in groups of 7 bits, the low ones first, and where the next thing begins."""
    value, shift = 0, 0
    while True:
        byte = data[place]
        place += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, place
        shift += 7
