"""Features as an ``.npz``, numpy's archive of arrays, which holds all of them."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ElfError, reason
from elf_runtime.files.kind import open_regular
from elf_runtime.results.quantization import SCALE, ZERO

_COLUMNS = ("keypoints", "scores", "descriptors", "sizes", "angles")


def write_npz(path: Path, fields: Mapping[str, Any]) -> None:
    """Write them, not compressed: descriptors hardly get smaller by it, and take nine times the time.

    Raises
    ------
    ElfError
        If the record is not plain data.
    """
    arrays = {name: fields[name] for name in _COLUMNS}
    arrays["image_size"], arrays["nms_radius"] = np.asarray(fields["image_size"]), np.float64(fields["nms_radius"])
    if fields["descriptors"].dtype == np.uint8:
        arrays["quantization"] = np.array([SCALE, ZERO])
    if fields["record"] is not None:
        arrays["record"] = _json(fields["record"])
    np.savez(path, **arrays)


def _json(record: Mapping[str, Any]) -> str:
    try:
        return json.dumps(dict(record), sort_keys=True)
    except (TypeError, ValueError, RecursionError) as error:
        raise ElfError(f"a record is plain data, as JSON holds it: {reason(error)}") from error


def read_npz(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The fields by name; nms_radius, sizes, angles and record only where the file has them.

    Raises
    ------
    ElfError
        If the file is missing, is no such file, or its arrays do not fit together.
    """
    try:
        with open_regular(path) as file:  # numpy would leave it open where it is damaged
            if not zipfile.is_zipfile(file):
                raise TypeError("it is no .npz archive")
            file.seek(0)
            data = np.load(file, allow_pickle=False)
            height, width = (int(side) for side in data["image_size"])
            fields = {name: _floats(data, name) for name in ("keypoints", "scores")}
            fields["descriptors"] = _descriptors(data)
            fields |= {name: _floats(data, name) for name in ("sizes", "angles") if name in data}
            radius = {"nms_radius": float(data["nms_radius"])} if "nms_radius" in data else {}
            record = {"record": _record(data)} if "record" in data else {}
    except Exception as error:  # what numpy, zipfile and zlib raise on a damaged file has no common base
        raise ElfError(f"{path}: not a feature file: {reason(error)}") from error
    points, scores, rows = fields["keypoints"], fields["scores"], fields["descriptors"]
    if rows.ndim != 2 or points.shape != (len(rows), 2) or scores.shape != (len(rows),):
        shapes = (points.shape, scores.shape, rows.shape)
        raise ElfError(f"{path}: keypoints, scores and descriptors have shapes {shapes}, not (N, 2), (N,), (N, D)")
    if min(height, width) < 1 or (radius and not radius["nms_radius"] >= 0):
        raise ElfError(f"{path}: image_size is {height, width} and nms_radius {radius.get('nms_radius', 0):g}")
    return {**fields, "image_size": (height, width), **radius, **record}


def load_record(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """The record that `Features.save` put into a ``.npz``; None where there is no such file or record."""
    try:
        with open_regular(path) as file, np.load(file, allow_pickle=False) as data:
            return _record(data)
    except Exception:  # what numpy, zipfile and zlib raise on another file has no common base
        return None


def is_torn(path: str | os.PathLike[str]) -> bool:
    """Whether a file begins as an ``.npz`` and ends too early, as a copy that was interrupted."""
    try:
        with open_regular(path) as file:
            begins = file.read(4) == b"PK\x03\x04"
            return begins and not zipfile.is_zipfile(file)
    except OSError:
        return False


def _record(data: Mapping[str, npt.NDArray[Any]]) -> dict[str, Any]:
    record = json.loads(str(data["record"]))
    if not isinstance(record, dict):
        raise TypeError("its record is no JSON object")
    return record


def _floats(data: Mapping[str, npt.NDArray[Any]], name: str) -> npt.NDArray[Any]:
    array = data[name]
    if array.dtype.kind != "f":
        raise TypeError(f"{name} is of {array.dtype}, not float32")
    return array.astype(np.float32, copy=False)


def _descriptors(data: Mapping[str, npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """Floats, or the bytes of `quantized`, which only a file with its scale and zero may hold: others are bits."""
    if data["descriptors"].dtype != np.uint8 or "quantization" not in data:
        return _floats(data, "descriptors")
    if data["quantization"].tolist() != [SCALE, ZERO]:
        raise TypeError(f"its descriptors are of 8 bits with scale and zero {data['quantization']}, not {SCALE, ZERO}")
    return data["descriptors"]
