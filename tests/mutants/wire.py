"""Model files with one thing wrong, made from bytes alone: the protobuf's fields, metadata, contract values."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from typing import Any

from elf_runtime.model.protobuf import Message, encoded, encoded_varint, raw_fields

# Message -> field number -> the message that the field holds, after onnx.proto.
SCHEMA: dict[str, dict[int, str]] = {
    "model": {7: "graph", 8: "opset", 14: "entry", 25: "function"},
    "graph": {1: "node", 5: "tensor", 11: "value", 12: "value", 13: "value"},
    "function": {7: "node", 9: "opset"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph"},
    "value": {2: "type"},
    "type": {1: "tensor type"},
    "tensor type": {2: "shape"},
    "shape": {1: "dimension"},
    "tensor": {13: "entry"},
    "entry": {},
    "opset": {},
    "dimension": {},
}
NUMBERS = (0, 1, 2, 3, 7, 64, 127, 255, 1000, 65536, 1 << 31, (1 << 31) - 1, 1 << 40, (1 << 64) - 1, (1 << 64) - 2)
TEXTS = (
    b"", b"\xff\xfe\xfd", b"x" * 300, b"\x1b[31m", b"\0", b"saliency", b"image", b"Loop", b"If", b"Scan", b"Resize",
    b"/dev/zero", b"../../secret", b"ConstantOfShape", b"Tile", b"Expand",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    0, -1, 1, 2, 1e-30, 1e30, float("nan"), float("inf"), 10**400, 1 << 31, "", "x" * 300, "\x1b[31m", None, True,
    [], {}, [[]], {"a": {}}, 20000, 0.001,
)  # fmt: skip


def mutants(data: bytes, seed: int) -> Iterator[tuple[str, bytes]]:
    """Endless mutants of a model file: what was changed, in words, and the file's bytes; the same for the same seed."""
    rng = random.Random(seed)
    while True:
        way = rng.random()
        if way < 0.45:
            yield _message(data, "model", rng)
        elif way < 0.8:
            yield _contract(data, rng)
        elif way < 0.9:
            yield _bytes(data, rng)
        else:
            what, once = _message(data, "model", rng)
            try:
                more, twice = _message(once, "model", rng)
                yield f"{what}; {more}", twice
            except Exception:  # what is no message any more has no fields to change
                yield what, once


def _message(data: bytes, kind: str, rng: random.Random) -> tuple[str, bytes]:
    """One field of a message, or of one inside it, is changed."""
    fields = [(number, value, bytes(raw)) for number, value, raw in raw_fields(memoryview(data))]
    known = SCHEMA[kind]
    inside = [i for i, (number, value, _) in enumerate(fields) if number in known and isinstance(value, memoryview)]
    if inside and rng.random() < 0.85:
        # Kinds of fields are drawn evenly: a graph has far more initializers than outputs.
        number = rng.choice(sorted({fields[i][0] for i in inside}))
        index = rng.choice([i for i in inside if fields[i][0] == number])
        value = fields[index][1]
        assert isinstance(value, memoryview)
        what, changed = _message(bytes(value), SCHEMA[kind][number], rng)
        fields[index] = (number, value, encoded(number, changed))
        return f"{kind}.{what}", b"".join(raw for _, _, raw in fields)
    if not fields:
        return f"{kind}: text added", encoded(rng.randrange(1, 30), rng.choice(TEXTS))
    index = rng.randrange(len(fields))
    number, value, _ = fields[index]
    way = rng.choice(("gone", "twice", "moved", "renumbered", "changed", "changed", "changed", "added"))
    if way == "gone":
        del fields[index]
    elif way == "twice":
        fields.insert(rng.randrange(len(fields) + 1), fields[index])
    elif way == "moved":
        fields.insert(rng.randrange(len(fields)), fields.pop(index))
    elif way == "renumbered":
        fields[index] = (number, value, _field(rng.randrange(1, 30), value))
    elif way == "added":
        extra = rng.choice((rng.choice(TEXTS), rng.choice(NUMBERS)))
        fields.append((0, 0, _field(rng.randrange(1, 30), extra)))
    else:
        fields[index] = (number, value, _field(number, _changed(value, rng)))
    return f"{kind} field {number} {way}", b"".join(raw for _, _, raw in fields)


def _changed(value: int | memoryview | bytes, rng: random.Random) -> int | bytes:
    if isinstance(value, int):
        return rng.choice(NUMBERS)
    data = bytearray(value)
    way = rng.randrange(5)
    if way == 0 or not data:
        return rng.choice(TEXTS)
    if way == 1:
        return rng.choice(NUMBERS)
    if way == 2:
        return bytes(data[: rng.randrange(len(data))])
    if way == 3:
        return bytes(data) + rng.randbytes(rng.randrange(1, 64))
    for _ in range(rng.randrange(1, 9)):
        data[rng.randrange(len(data))] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    return bytes(data)


def _field(number: int, value: int | memoryview | bytes) -> bytes:
    if isinstance(value, int):
        return encoded_varint(number << 3) + encoded_varint(value)
    return encoded(number, bytes(value))


def _contract(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    """A value of the contract, at any depth, is changed; or its JSON is broken."""
    model = Message(memoryview(data))
    entries = {m.text(1): m.text(2) for m in map(Message, model.parts(14))}
    if not entries:
        return _message(data, "model", rng)
    key = rng.choice(sorted(entries))
    text = entries[key]
    way = rng.randrange(6)
    if way == 0:
        half = text[: len(text) // 2]
        changed = rng.choice(("[" * 50_000, half, "", "NaN", '"' + "x" * 100_000 + '"', "9" * 400, "null"))
    else:
        try:
            value, where = _value(json.loads(text), rng)
        except ValueError:
            value, where = rng.choice(VALUES), ""
        changed = json.dumps(value)
        key = f"{key}{where}"
    name = key.split("[")[0]
    rest = b"".join(bytes(raw) for number, _, raw in raw_fields(memoryview(data)) if number != 14)
    entries[name] = changed
    if rng.random() < 0.05:
        del entries[name]
    metadata = b"".join(encoded(14, encoded(1, k.encode()) + encoded(2, v.encode())) for k, v in entries.items())
    return f"{key} is {changed[:60]}", rest + metadata


def _value(value: Any, rng: random.Random) -> tuple[Any, str]:
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = rng.choice(sorted(value))
        changed, where = _value(value[key], rng)
        return {**value, key: changed}, f"[{key}]{where}"
    if isinstance(value, list) and value and rng.random() < 0.9:
        index = rng.randrange(len(value))
        changed, where = _value(value[index], rng)
        return [*value[:index], changed, *value[index + 1 :]], f"[{index}]{where}"
    return rng.choice(VALUES), ""


def _bytes(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    """The file itself: cut off, bytes changed, something in front or behind."""
    way = rng.randrange(4)
    if way == 0:
        length = rng.randrange(len(data))
        return f"cut off at {length}", data[:length]
    if way == 1:
        changed = bytearray(data)
        places = [rng.randrange(len(data)) for _ in range(rng.choice((1, 1, 2, 8, 100)))]
        for place in places:
            changed[place] = rng.randrange(256)
        return f"bytes {places[:8]} changed", bytes(changed)
    junk = rng.randbytes(rng.randrange(1, 100))
    return ("junk in front", junk + data) if way == 2 else ("junk behind", data + junk)
