"""An image to detect on, a run of elf-detect on the tiny model, and the results in a folder."""

from __future__ import annotations

from pathlib import Path

import cv2

from elf_runtime.commands.bench_workloads import synthetic
from elf_runtime.commands.detect import main
from helpers import TINY


def write(path: Path, seed: int = 0, size: tuple[int, int] = (96, 128)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), synthetic(*size, seed=seed))
    return path


def results(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*.npz")}


def detect(*arguments: object) -> int:
    return main([str(a) for a in arguments] + ["--model", str(TINY), "--threads", "1"])
