"""Features of many images as a table of Parquet, a row for each.  Needs pyarrow.

Columns: name, image and sha256 (string), height and width (int32), nms_radius (float64), keypoints (a list of pairs
x, y of float32), scores, sizes and angles (lists of float32), descriptors (the bytes of (N, D) float32, little-endian,
row by row), descriptor_length (D, int32), and record (JSON).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ElfError, first_line
from elf_runtime.results.features import Features
from elf_runtime.results.quantization import restored

from .store import needed

_LISTS = ("scores", "sizes", "angles")


def write_parquet(path: Path, rows: Mapping[str, Features]) -> None:
    """Write name -> features, which have a record of their image."""
    arrow, parquet = needed("pyarrow"), needed("pyarrow.parquet")
    found = list(rows.values())
    records = [dict(features.record or {}) for features in found]
    ends = np.cumsum([0, *(len(features) for features in found)]).astype(np.int32)
    columns = {
        "name": arrow.array(list(rows), arrow.string()),
        "image": arrow.array([record.get("image") for record in records], arrow.string()),
        "sha256": arrow.array([record.get("image_sha256") for record in records], arrow.string()),
        "height": arrow.array([features.image_size[0] for features in found], arrow.int32()),
        "width": arrow.array([features.image_size[1] for features in found], arrow.int32()),
        "nms_radius": arrow.array([features.nms_radius for features in found], arrow.float64()),
        "keypoints": _lists(arrow, ends, _pairs(arrow, _joined([features.keypoints for features in found]))),
    }
    for name in _LISTS:
        columns[name] = _lists(arrow, ends, arrow.array(_joined([getattr(features, name) for features in found])))
    vectors = [_floats(features.descriptors) for features in found]
    columns["descriptors"] = arrow.array([array.tobytes() for array in vectors], arrow.large_binary())
    columns["descriptor_length"] = arrow.array([array.shape[1] for array in vectors], arrow.int32())
    columns["record"] = arrow.array([json.dumps(record, sort_keys=True) for record in records], arrow.string())
    # Floats hardly get smaller, neither by a dictionary of their values nor packed.
    parquet.write_table(arrow.table(columns), path, use_dictionary=False, compression="none", row_group_size=64)


def read_parquet(path: Path) -> Iterator[tuple[str, Features]]:
    """The names and features of a file, in its order.

    Raises
    ------
    ElfError
        If it is no such file, or damaged.
    """
    parquet = needed("pyarrow.parquet")
    try:
        with parquet.ParquetFile(path) as file:
            for batch in file.iter_batches(batch_size=64):
                for row in range(batch.num_rows):
                    yield batch["name"][row].as_py(), _features(batch, row)
    except (ArithmeticError, AttributeError, LookupError, OSError, TypeError, ValueError) as error:
        raise ElfError(f"{path}: not a shard of features: {first_line(error)}") from error


def parquet_records(file: BinaryIO, shard: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """The names and records alone, of an open file; `shard` is its name for errors, as of `read_parquet`."""
    try:
        table = needed("pyarrow.parquet").read_table(file, columns=["name", "record"])
        names, texts = table["name"].to_pylist(), table["record"].to_pylist()
        records = [json.loads(text) for text in texts]
    except (LookupError, OSError, TypeError, ValueError) as error:
        raise ElfError(f"{shard}: not a shard of features: {first_line(error)}") from error
    yield from zip(names, records, strict=True)


def _features(batch: Any, row: int) -> Features:
    points = batch["keypoints"][row].values.flatten().to_numpy(zero_copy_only=False).reshape(-1, 2)
    lists = {name: batch[name][row].values.to_numpy(zero_copy_only=False) for name in _LISTS}
    width = batch["descriptor_length"][row].as_py()
    rows = np.frombuffer(batch["descriptors"][row].as_py(), "<f4").reshape(len(points), width)
    return Features(
        points.astype(np.float32),
        lists["scores"].astype(np.float32),
        rows.astype(np.float32),
        (batch["height"][row].as_py(), batch["width"][row].as_py()),
        nms_radius=batch["nms_radius"][row].as_py(),
        sizes=lists["sizes"].astype(np.float32),
        angles=lists["angles"].astype(np.float32),
        record=json.loads(batch["record"][row].as_py()),
    )


def _floats(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return (restored(rows) if rows.dtype == np.uint8 else rows).astype("<f4", copy=False)


def _joined(arrays: list[npt.NDArray[Any]]) -> npt.NDArray[np.float32]:
    return np.concatenate([np.zeros(0, np.float32), *(np.asarray(array, np.float32).ravel() for array in arrays)])


def _pairs(arrow: Any, values: npt.NDArray[np.float32]) -> Any:
    return arrow.FixedSizeListArray.from_arrays(arrow.array(values), 2)


def _lists(arrow: Any, ends: npt.NDArray[np.int32], values: Any) -> Any:
    """Lists of values that follow one another, list i from ``ends[i]`` to ``ends[i + 1]``."""
    return arrow.ListArray.from_arrays(arrow.array(ends), values)
