"""Reading tensors from any of the usual files, told apart by content rather than by ending."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_export.errors import WeightsError

Array = npt.NDArray[Any]


def read_tensors(path: Path) -> dict[str, Array]:
    """All tensors of a file, by name, in natural order of the names (``conv2`` before ``conv10``).

    Understood are PyTorch (.pth, .pt; loaded with ``weights_only``), Keras (.h5, .keras), .safetensors, .npz
    and .onnx; which one it is, is read from the file's first bytes.  The kernels and biases of an .onnx file's
    Conv nodes are called ``NODE.weight`` and ``NODE.bias``, with nodes numbered in graph order, unless they
    bear such names already.

    Raises
    ------
    WeightsError
        If the file is missing, none of these, or holds no tensors.
    """
    try:
        with open(path, "rb") as file:
            head = file.read(16)
    except OSError as error:
        raise WeightsError(f"{path}: {error.strerror or error}") from error
    reader = _reader_for(path, head)
    try:
        tensors = reader(path)
    except WeightsError:
        raise
    except ImportError as error:
        raise WeightsError(f"{path}: reading this file needs {error.name}: pip install {error.name}") from error
    except Exception as error:
        raise WeightsError(f"{path}: unreadable as {reader.__name__.removeprefix('_read_')}: {error}") from error
    if not tensors:
        raise WeightsError(f"{path}: holds no tensors")
    return {name: tensors[name] for name in sorted(tensors, key=_natural)}


def _reader_for(path: Path, head: bytes) -> Callable[[Path], dict[str, Array]]:
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        return _read_hdf5
    if head.startswith(b"PK"):
        try:
            with zipfile.ZipFile(path) as archive:
                names = archive.namelist()
        except zipfile.BadZipFile as error:
            raise WeightsError(f"{path}: unreadable as a zip archive (.pth, .keras, .npz): {error}") from error
        if any(name.endswith(".weights.h5") for name in names):
            return _read_keras
        return _read_npz if all(name.endswith(".npy") for name in names) else _read_torch
    if len(head) > 9 and head[8:9] == b"{" and int.from_bytes(head[:8], "little") < path.stat().st_size:
        return _read_safetensors
    if head.startswith(b"\x80"):  # a pickle: PyTorch before 1.6
        return _read_torch
    if head[:1] == b"\x08":  # field 1 of ModelProto, ir_version
        return _read_onnx
    raise WeightsError(f"{path}: not a .pth, .h5, .keras, .safetensors, .npz or .onnx file")


def _read_npz(path: Path) -> dict[str, Array]:
    with np.load(path, allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def _read_torch(path: Path) -> dict[str, Array]:
    import torch

    state: Any = torch.load(path, map_location="cpu", weights_only=True)
    for key in ("state_dict", "model_state_dict", "model"):
        if isinstance(state, dict) and isinstance(state.get(key), dict):
            state = state[key]
    if not isinstance(state, dict):
        raise WeightsError(f"{path}: holds a {type(state).__name__}, not a state dict")
    found = {name: value for name, value in state.items() if isinstance(value, torch.Tensor)}
    return {name.removeprefix("module."): value.float().numpy() for name, value in found.items()}


def _read_safetensors(path: Path) -> dict[str, Array]:
    from safetensors.numpy import load_file

    loaded: dict[str, Array] = load_file(path)
    return loaded


def _read_hdf5(path: Path) -> dict[str, Array]:
    import h5py

    with h5py.File(path, "r") as file:
        return _datasets(file)


def _read_keras(path: Path) -> dict[str, Array]:
    import h5py

    with zipfile.ZipFile(path) as archive:
        member = next(name for name in archive.namelist() if name.endswith(".weights.h5"))
        with archive.open(member) as data, h5py.File(data, "r") as file:
            return _datasets(file)


def _datasets(file: Any) -> dict[str, Array]:
    import h5py

    found: dict[str, Array] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind == "f":
            found[name] = np.asarray(item)

    file.visititems(visit)
    return found


def _read_onnx(path: Path) -> dict[str, Array]:
    import onnx
    from onnx import numpy_helper

    model = onnx.load(path)
    tensors = {t.name: t for t in model.graph.initializer}
    named: dict[str, str] = {}
    convs = [node for node in model.graph.node if node.op_type == "Conv"]
    for index, node in enumerate(convs):
        for name, role in zip(node.input[1:], ("weight", "bias"), strict=False):
            if name in tensors and not name.endswith(f".{role}"):
                named[name] = f"node{index}.{role}"
    return {named.get(name, name): numpy_helper.to_array(t) for name, t in tensors.items()}


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort key under which numbers inside a name compare as numbers."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
