"""The file that an export writes: a place asked for before any work, one file written in one step."""

from __future__ import annotations

import os
from pathlib import Path

import onnx

import elf_runtime
from elf_runtime import ModelContract
from elf_runtime.files.write import unwritable, write_atomically

from .errors import ExportError

LONGEST = 80  # bytes of the network's and of the layer's name in that of the file


def default_name(network: str, layer: str) -> str:
    """``elf-NETWORK-LAYER.onnx``, of a length that file systems take."""
    name = "".join(c if c.isalnum() or c in "._" else "_" for c in layer).strip("_.") or "layer"
    while len(os.fsencode(name)) > LONGEST:
        name = name[1:]
    while len(os.fsencode(network)) > LONGEST:
        network = network[:-1]
    return f"elf-{network}-{name.strip('_.')}.onnx"


def check_output(output: str | os.PathLike[str], force: bool) -> Path:
    """The path to write to, once it is sure that writing there is wanted and possible."""
    path = Path(output)
    try:
        _check_place(path, force)
    except (OSError, ValueError) as error:  # a name that is too long, or that holds a NUL
        raise ExportError(f"{os.fspath(output)!r}: {getattr(error, 'strerror', None) or error}") from error
    return path


def _check_place(path: Path, force: bool) -> None:
    if path.suffix.lower() != ".onnx":
        raise ExportError(f"{path}: a model's name ends in .onnx (elf-info --ort makes an .ort file of one)")
    if path.is_dir():
        raise ExportError(f"{path} is a folder; --output names a file")
    if path.exists() and not force:
        raise ExportError(f"{path} exists; --force overwrites it")
    if reason := unwritable(path.parent):
        raise ExportError(reason)


def stamped(model: onnx.ModelProto, contract: ModelContract | None) -> bytes:
    """The file's bytes: the model with the contract, if it has one, as its metadata."""
    model.producer_name = "elf-onnx"
    model.producer_version = elf_runtime.__version__
    onnx.helper.set_model_props(model, contract.to_metadata() if contract is not None else {})
    data: bytes = model.SerializeToString(deterministic=True)
    return data


def write(model: onnx.ModelProto, contract: ModelContract | None, path: Path) -> None:
    """Put the model with its contract, if it has one, in place in one step."""
    data = stamped(model, contract)
    try:
        write_atomically(path, lambda part: part.write_bytes(data))
    except OSError as error:
        raise ExportError(f"{path}: {error.strerror or error}") from error
