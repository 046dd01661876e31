"""Writes TensorFlow's checkpoints: what is needed of the format, apart from the code that reads it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

TYPES = {"float32": 1, "float64": 2, "int32": 3, "int64": 9}


def varint(value: int) -> bytes:
    out = bytearray()
    while value >= 128:
        out.append(value % 128 + 128)
        value //= 128
    return bytes([*out, value])


def block(entries: list[tuple[bytes, bytes]]) -> bytes:
    """Keys without what they share with the one before; every 16th whole, and where those begin, at the end."""
    out, restarts, last = b"", [], b""
    for number, (key, value) in enumerate(entries):
        shared = 0
        if number % 16 == 0:
            restarts.append(len(out))
        else:
            while shared < min(len(key), len(last)) and key[shared] == last[shared]:
                shared += 1
        out += varint(shared) + varint(len(key) - shared) + varint(len(value)) + key[shared:] + value
        last = key
    return out + struct.pack(f"<{len(restarts) + 1}I", *restarts, len(restarts))


def write_checkpoint(folder: Path, name: str, tensors: dict[str, np.ndarray], per_block: int = 7) -> Path:
    """The index's path; its blocks hold `per_block` keys each."""
    data, entries = b"", [(b"", b"\x08\x01\x1a\x02\x08\x01")]  # one data file, version 1
    for key in sorted(tensors):
        value = tensors[key]
        shape = b"".join(b"\x12" + varint(len(dim)) + dim for dim in (b"\x08" + varint(n) for n in value.shape))
        raw = value.tobytes()
        fields = b"\x08" + varint(TYPES[str(value.dtype)]) + b"\x12" + varint(len(shape)) + shape
        fields += b"\x20" + varint(len(data)) + b"\x28" + varint(len(raw)) + b"\x35" + b"\0\0\0\0"  # and a checksum
        entries.append((key.encode(), fields))
        data += raw
    table, handles = b"", []
    for first in range(0, len(entries), per_block):
        part = entries[first : first + per_block]
        body = block(part)
        handles.append((part[-1][0], varint(len(table)) + varint(len(body))))
        table += body + b"\0" + b"\0\0\0\0"
    places = []
    for body in (block([]), block(handles)):  # of metadata, and of the blocks
        places.append(varint(len(table)) + varint(len(body)))
        table += body + b"\0" + b"\0\0\0\0"
    footer = b"".join(places).ljust(40, b"\0") + (0xDB4775248B80FB57).to_bytes(8, "little")
    (folder / f"{name}.data-00000-of-00001").write_bytes(data)
    (folder / f"{name}.index").write_bytes(table + footer)
    return folder / f"{name}.index"
