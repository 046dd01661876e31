"""A hash over tensors themselves, so that any file format and any source can prove the same network."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

Tensors = Mapping[str, npt.NDArray[np.float32]]


def fingerprint(tensors: Tensors) -> str:
    """SHA-256 over names, shapes and little-endian float32 values, in the order of the names."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        value = np.ascontiguousarray(tensors[name], "<f4")
        digest.update(f"{name}:{','.join(map(str, value.shape))};".encode())
        digest.update(value.tobytes())
    return digest.hexdigest()


def mismatches(tensors: Tensors, known: Mapping[str, str]) -> list[str]:
    """Layers (``NAME`` of ``NAME.weight`` and ``NAME.bias``) of `tensors` that differ from the `known` prints."""
    layers: dict[str, dict[str, npt.NDArray[np.float32]]] = {}
    for name, value in tensors.items():
        layers.setdefault(name.rpartition(".")[0], {})[name] = value
    return [layer for layer, parts in layers.items() if known.get(layer) != fingerprint(parts)]
