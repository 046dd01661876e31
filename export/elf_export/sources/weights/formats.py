"""Reading tensors from any of the usual files, told apart by content rather than by ending."""

from __future__ import annotations

import pickle
import re
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_export.errors import WeightsError
from elf_runtime.errors import first_line, reason
from elf_runtime.files.kind import HEAD, description, open_regular

from .tensorflow_checkpoint import is_index, read_checkpoint

Array = npt.NDArray[Any]

# What no network needs that is meant to run as a keypoint detector, and what nobody should wait or make room for.
MOST_BYTES = 2 << 30
DEEPEST = 64  # groups of an HDF5 file inside one another


def read_tensors(path: Path) -> dict[str, Array]:
    """All tensors of a file, by name, in natural order of the names (``conv2`` before ``conv10``).

    Understood are PyTorch (.pth, .pt; loaded with ``weights_only``), Keras (.h5, .keras), .safetensors, .npz,
    TensorFlow's checkpoints (.index, with the data beside it) and .onnx; which one it is, is read from the file's first
    bytes, or a checkpoint's last.  The kernels and biases of an .onnx file's Conv nodes are called ``NODE.weight`` and
    ``NODE.bias``, with nodes numbered in graph order, unless they bear such names already.

    Raises
    ------
    WeightsError
        If the file is missing, none of these, holds no tensors, or complex ones, or more than 2 GiB of them.
    """
    try:
        with open_regular(path) as file:
            head = file.read(HEAD)
        _check_bytes(path, path.stat().st_size)
    except OSError as error:
        raise WeightsError(f"{path}: {reason(error)}{_name_the_index(path)}") from error
    reader = _reader_for(path, head)
    try:
        tensors = reader(path)
    except WeightsError:
        raise
    except ImportError as error:
        raise WeightsError(f"{path}: reading this file needs {error.name}: pip install {error.name}") from error
    except Exception as error:
        kind = reader.__name__.removeprefix("_read_")
        raise WeightsError(f"{path}: unreadable as {kind}: {first_line(error)}") from error
    for name, tensor in tensors.items():
        if tensor.dtype.kind == "c":
            raise WeightsError(f"{path}: the tensor {name!r} is of {tensor.dtype}; networks have real numbers")
    numbers = {name: tensor for name, tensor in tensors.items() if tensor.dtype.kind in "fiub"}
    if not numbers:
        others = f": {', '.join(sorted({str(tensor.dtype) for tensor in tensors.values()}))[:100]}" if tensors else ""
        raise WeightsError(f"{path}: holds no tensors of numbers{others}")
    tensors = numbers
    return {name: tensors[name] for name in sorted(tensors, key=_natural)}


def _check_bytes(path: Path, size: int) -> None:
    if size > MOST_BYTES:
        raise WeightsError(f"{path}: holds {size / 2**30:.1f} GiB; weights of at most {MOST_BYTES >> 30} GiB are read")


def _reader_for(path: Path, head: bytes) -> Callable[[Path], dict[str, Array]]:
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        return _read_hdf5
    if is_index(path):
        return read_checkpoint
    if head.startswith(b"PK"):
        try:
            with zipfile.ZipFile(path) as archive:
                names = archive.namelist()
                unpacked = sum(member.file_size for member in archive.infolist())
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
            kind = "a zip archive (.pth, .keras, .npz) that is damaged or cut off"
            raise WeightsError(f"{path}: {kind}: {error}") from error
        _check_bytes(path, unpacked)
        if any(name.endswith(".weights.h5") for name in names):
            return _read_keras
        return _read_npz if all(name.endswith(".npy") for name in names) else _read_torch
    if len(head) > 9 and head[8:9] == b"{" and int.from_bytes(head[:8], "little") < path.stat().st_size:
        return _read_safetensors
    if head.startswith(b"\x80"):  # a pickle: PyTorch before 1.6
        return _read_torch
    if head[:1] == b"\x08":  # field 1 of ModelProto, ir_version
        return _read_onnx
    what = description(head, path.stat().st_size)
    kinds = "not a .pth, .h5, .keras, .safetensors, .npz, .index or .onnx file"
    raise WeightsError((f"{path}: {kinds}: it is {what}" if what else f"{path}: {kinds}") + _name_the_index(path))


def _name_the_index(path: Path) -> str:
    """What to name instead of a TensorFlow checkpoint's prefix or one of its other files; empty for what is none."""
    index = path.with_name(re.sub(r"\.(data-\d+-of-\d+|meta)$", "", path.name) + ".index")
    return f"; it is a TensorFlow checkpoint's, which is named by its index: {index}" if index.is_file() else ""


def _read_npz(path: Path) -> dict[str, Array]:
    with np.load(path, allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def _read_torch(path: Path) -> dict[str, Array]:
    import torch

    try:
        state: Any = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        if "Unsupported global" not in str(error):
            raise WeightsError(f"{path}: unreadable as torch: the pickle is damaged, or of another kind") from error
        raise WeightsError(
            f"{path}: holds more than tensors, a pickled module for example, which may run any code; save the module's "
            "state_dict() instead"
        ) from error
    for key in ("state_dict", "model_state_dict", "model"):
        if isinstance(state, dict) and isinstance(state.get(key), dict):
            state = state[key]
    if not isinstance(state, dict):
        raise WeightsError(f"{path}: holds a {type(state).__name__}, not a state dict")
    found = {str(name): value for name, value in state.items() if isinstance(value, torch.Tensor)}
    return {name.removeprefix("module."): value for name, value in _from_torch(path, found).items()}


def _from_torch(path: Path, found: dict[str, Any]) -> dict[str, Array]:
    for name, value in found.items():
        if value.is_complex():
            raise WeightsError(f"{path}: the tensor {name!r} is of {value.dtype}; networks have real numbers")
    _check_bytes(path, sum(4 * value.numel() for value in found.values()))  # a view may be far larger than its values
    return {name: value.detach().float().numpy() for name, value in found.items()}


def _read_safetensors(path: Path) -> dict[str, Array]:
    try:
        from safetensors.torch import load_file as load_torch
    except ImportError:
        from safetensors.numpy import load_file

        loaded: dict[str, Array] = load_file(path)
        return loaded
    return _from_torch(path, load_torch(path))  # knows bfloat16 and float8, which numpy does not


def _read_hdf5(path: Path) -> dict[str, Array]:
    import h5py

    with h5py.File(path, "r") as file:
        return _datasets(file, path)


def _read_keras(path: Path) -> dict[str, Array]:
    import h5py

    with zipfile.ZipFile(path) as archive:
        member = next(name for name in archive.namelist() if name.endswith(".weights.h5"))
        with archive.open(member) as data, h5py.File(data, "r") as file:
            return _datasets(file, path)


def _datasets(file: Any, path: Path) -> dict[str, Array]:
    datasets = dict(_members(file, path))
    _check_bytes(path, sum(dataset.nbytes for dataset in datasets.values()))
    return {name: np.asarray(dataset) for name, dataset in datasets.items()}


def _members(file: Any, path: Path) -> Iterator[tuple[str, Any]]:
    """Every dataset of floats by its name; links to other places and files are not followed."""
    import h5py

    groups, visited = [("", file, 0)], set()
    while groups:
        prefix, group, depth = groups.pop()
        if depth > DEEPEST:
            raise WeightsError(f"{path}: its groups are nested more than {DEEPEST} deep")
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            item = group[name]
            if isinstance(item, h5py.Group):
                place = h5py.h5o.get_info(item.id).addr
                if place not in visited:  # several links may lead to a group, and in circles
                    visited.add(place)
                    groups.append((f"{prefix}{name}/", item, depth + 1))
            elif isinstance(item, h5py.Dataset) and item.dtype.kind == "f" and not (item.external or item.is_virtual):
                yield f"{prefix}{name}", item


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
