"""Protobuf's wire format, as much of it as an .onnx file needs.

On the wire a message is a row of fields: a varint key ``number << 3 | type``, then by type a varint (0),
8 bytes (1), a length and that many bytes (2: text, submessage, packed numbers), or 4 bytes (5).  Which
numbers mean what stands in the .proto file; a reader that knows those it wants skips all others.
"""

from __future__ import annotations

from collections.abc import Iterator


class WireError(Exception):
    """The bytes are not the message that they should be."""


class Message:
    """The fields of one message, by their numbers in the .proto file; an absent one is empty or zero.

    Raises
    ------
    WireError
        Here and in the methods, if the bytes are no message, or a field is not of the kind asked for.
    """

    def __init__(self, data: memoryview) -> None:
        self._fields: dict[int, list[int | memoryview]] = {}
        for number, value, _ in raw_fields(data):
            self._fields.setdefault(number, []).append(value)

    def __contains__(self, number: int) -> bool:
        return number in self._fields

    def parts(self, number: int) -> list[memoryview]:
        """Submessages, or raw bytes, in file order."""
        values = self._fields.get(number, [])
        found = [value for value in values if isinstance(value, memoryview)]
        if len(found) < len(values):
            raise WireError(f"field {number} holds a number in place of a message or text")
        return found

    def texts(self, number: int) -> list[str]:
        try:
            return [bytes(part).decode() for part in self.parts(number)]
        except UnicodeDecodeError:
            raise WireError(f"field {number} is not text") from None

    def text(self, number: int) -> str:
        """The last one counts, as protobuf has it for a field that is not repeated."""
        return (self.texts(number) or [""])[-1]

    def integers(self, number: int) -> list[int]:
        """Varints, packed or not, as signed 64-bit integers."""
        found: list[int] = []
        for value in self._fields.get(number, []):
            at = 0
            while isinstance(value, memoryview) and at < len(value):
                packed, at = _varint(value, at)
                found.append(packed)
            if isinstance(value, int):
                found.append(value)
        return [value - 2**64 if value >= 2**63 else value for value in found]

    def integer(self, number: int) -> int:
        return (self.integers(number) or [0])[-1]


def encoded(number: int, payload: bytes) -> bytes:
    """A field of wire type 2 as bytes: a submessage, or text."""
    return encoded_varint(number << 3 | 2) + encoded_varint(len(payload)) + payload


def raw_fields(data: memoryview) -> Iterator[tuple[int, int | memoryview, memoryview]]:
    """The fields of a message in file order: number, value, and all of the field's bytes, key included."""
    at = 0
    while at < len(data):
        start = at
        key, at = _varint(data, at)
        number, kind = key >> 3, key & 7
        if number == 0:
            raise WireError("a field has the number 0")
        if kind == 0:
            value, at = _varint(data, at)
            yield number, value, data[start:at]
            continue
        if kind == 2:
            length, at = _varint(data, at)
        elif kind in (1, 5):
            length = 8 if kind == 1 else 4
        else:
            raise WireError(f"field {number} is of the unknown wire type {kind}")
        if length > len(data) - at:
            raise WireError(f"field {number} needs {length} bytes, {len(data) - at} are left")
        yield number, data[at : at + length], data[start : at + length]
        at += length


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """A number and the place behind it: 7 bits a byte, lowest first; the high bit says that more follow."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            raise WireError("it ends inside a number")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & (2**64 - 1), at
    raise WireError("a number has more than ten bytes")


def encoded_varint(value: int) -> bytes:
    """A number from 0 up as bytes: 7 bits each, lowest first; the high bit says that more follow."""
    low = bytearray()
    while value > 0x7F:
        low.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*low, value])
