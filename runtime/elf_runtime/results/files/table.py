"""Features as a ``.csv``: a row of names, then one row for each keypoint.  Descriptors are not in it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from elf_runtime.errors import ElfError, reason
from elf_runtime.files.kind import open_regular

HEADER = "x,y,score,size,angle"
_ROW = "%.3f,%.3f,%.6g,%.3f,%.3f\n"


def write_csv(path: Path, fields: Mapping[str, Any]) -> None:
    """Write them: lengths and angles in thousandths, scores in six digits."""
    angles = np.round(fields["angles"].astype(np.float64), 3)
    angles = np.where(angles == 360, 0.0, angles)
    table = np.column_stack([fields["keypoints"], fields["scores"], fields["sizes"], angles])
    # All rows by one format, in a third of np.savetxt's time.
    rows = _ROW * len(table) % tuple(table.ravel().tolist())
    path.write_text(f"{HEADER}\n{rows}", encoding="ascii", newline="\n")


def read_csv(path: str | os.PathLike[str], image_size: tuple[int, int]) -> dict[str, Any]:
    """The fields by name.  The suppression radius is that of the smallest size.

    Raises
    ------
    ElfError
        If the file is missing, or is not such a table of finite numbers.
    """
    try:
        with open_regular(path) as file:
            lines = file.read().decode("utf-8-sig").split("\n")
        names = lines[0].strip()
        if names != HEADER:
            raise ValueError(f"its first line is {names[:80]!r}, not {HEADER!r}")
        rows = [line.split(",") for line in lines[1:] if line.strip()]
        if any(len(row) != 5 for row in rows):
            raise ValueError("a line has not five values")
        table = np.array(rows, np.float64).astype(np.float32).reshape(-1, 5)
    except (OSError, ValueError) as error:
        raise ElfError(f"{path}: not a table of features: {reason(error)}") from error
    if not np.isfinite(table).all():
        raise ElfError(f"{path}: not a table of features: some values are NaN or infinite")
    x, y, scores, sizes, angles = table.T
    return {
        "keypoints": np.stack([x, y], axis=1),
        "scores": scores.copy(),
        "descriptors": np.zeros((len(table), 0), np.float32),
        "image_size": image_size,
        "nms_radius": radius_of(sizes),
        "sizes": sizes.copy(),
        "angles": angles.copy(),
    }


def radius_of(sizes: Any) -> float:
    """The suppression radius whose window, 2 radius + 1, is the smallest size; 10, the default, without sizes."""
    return max(0.0, (float(np.min(sizes)) - 1) / 2) if len(sizes) else 10.0
