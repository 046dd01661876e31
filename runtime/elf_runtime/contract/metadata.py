"""A contract as metadata: a key ``elf.NAME`` with JSON for every field, and the schema's number beside them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, get_type_hints

from elf_runtime.errors import ContractError, first_line
from elf_runtime.plain import read_json, read_value

from .specs import LARGEST_SIDE

SCHEMA_VERSION = 1
KEY_PREFIX = "elf."
LARGEST_NUMBER = 1e15


def write_metadata(values: Mapping[str, Any]) -> dict[str, str]:
    """``{key: text}`` of a contract's fields as plain data."""
    stated = {"schema": SCHEMA_VERSION, **values}
    return {KEY_PREFIX + name: json.dumps(value, sort_keys=True) for name, value in stated.items()}


def read_metadata(kind: Any, metadata: Mapping[str, str], file: str) -> dict[str, Any]:
    """The fields of a contract, a dataclass `kind`, that the metadata of `file` state.

    Raises
    ------
    ContractError
        See `ModelContract.from_metadata`.
    """
    key = KEY_PREFIX + "schema"
    if key not in metadata:
        raise ContractError(
            f"{file}: not an ELF model: its metadata has no {key!r}. Any CNN can be made one: "
            f"elf-export --onnx {file} --layer NAME --desc none (elf-export --onnx {file} --list shows the layers)"
        )
    again = metadata.get(KEY_PREFIX + "command", "").strip('"')[:500] or "elf-export --net NETWORK --layer LAYER"
    hint = f"This runtime reads schema {SCHEMA_VERSION}. Export it again: {again}"
    if metadata[key] != str(SCHEMA_VERSION):
        raise ContractError(f"{file}: metadata key {key!r} is {metadata[key][:100]}. {hint}")
    hints, values = get_type_hints(kind), {}
    for field in fields(kind):  # a later minor version may say more
        key = KEY_PREFIX + field.name
        if key in metadata:
            try:
                values[field.name] = _value(hints[field.name], metadata[key])
            except (ValueError, RecursionError) as error:  # SettingError is a ValueError
                raise ContractError(
                    f"{file}: metadata key {key!r} is unreadable: {first_line(error)}. {hint}"
                ) from error
        elif (field.default is MISSING and field.default_factory is MISSING) or field.name in ("input", "descriptors"):
            raise ContractError(f"{file}: metadata key {key!r} is missing. {hint}")
    if values["stride"] == 0:
        raise ContractError(f"{file}: metadata key 'elf.stride' is 0. {hint}")
    return values


def _value(kind: Any, text: str) -> Any:
    """A field's value, of its type and in its range."""
    value = read_value(kind, read_json(text, LARGEST_NUMBER), ignore_unknown=True)
    if kind is float and not 0 <= value <= LARGEST_SIDE:
        raise ValueError(f"expected a number of pixels from 0 to {LARGEST_SIDE}, found {value!r}")
    for part in value if isinstance(value, tuple) else (value,):
        if hasattr(part, "check"):
            part.check()
    return float(value) if kind is float else value
