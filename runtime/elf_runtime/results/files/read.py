"""Read a file of features by its ending."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from elf_runtime.errors import ElfError
from elf_runtime.values import is_int

from .npz import read_npz
from .table import read_csv


def read_fields(path: str | os.PathLike[str], image_size: tuple[int, int] | None) -> dict[str, Any]:
    """The fields of `Features` by name: see `Features.load`."""
    if image_size is not None and not _is_size(image_size):
        raise ElfError(f"image_size is (height, width) in pixels, not {image_size!r}")
    size = None if image_size is None else (int(image_size[0]), int(image_size[1]))
    if Path(os.fsdecode(path)).suffix == ".csv":
        if size is None:
            raise ElfError(f"{path}: a .csv does not have the image's size; give image_size=(height, width)")
        return read_csv(path, size)
    fields = read_npz(path)
    if size not in (None, fields["image_size"]):
        raise ElfError(f"{path}: image_size is {fields['image_size']} there, not {size}")
    return fields


def _is_size(size: Any) -> bool:
    return isinstance(size, (tuple, list)) and len(size) == 2 and all(is_int(side) and side >= 1 for side in size)
