"""Finding images and reading matrices, with errors that name the file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from elf_eval.coordinates import Float
from elf_eval.errors import EvalError

from .images import IMAGE_ENDINGS
from .truth import Homography


def is_image(path: Path) -> bool:
    """Whether a file's ending is an image's; hidden files don't count."""
    return path.suffix.lower() in IMAGE_ENDINGS and not path.name.startswith(".")


def images_in(folder: Path) -> list[Path]:
    """The images of a folder, numbers in their names by value ("2.png" before "10.png").

    Raises
    ------
    EvalError
        If there is none.
    """
    found = sorted((p for p in folder.iterdir() if is_image(p)), key=natural) if folder.is_dir() else []
    if not found:
        raise EvalError(f"{folder}: no images here ({', '.join(IMAGE_ENDINGS)})")
    return found


def images_to_pair(folder: Path) -> list[Path]:
    """As `images_in`, two at least.

    Raises
    ------
    EvalError
        If there is none or only one.
    """
    found = images_in(folder)
    if len(found) < 2:
        raise EvalError(f"{folder}: only one image here, {found[0].name}; a scene's pairs need two")
    return found


def folders_in(root: Path) -> list[Path]:
    """The visible subfolders, in natural order."""
    return sorted((p for p in root.iterdir() if p.is_dir() and not p.name.startswith(".")), key=natural)


def scene_name(folder: Path) -> str:
    """A folder's own name, however it was written (".", "x/..")."""
    return folder.resolve().name or "scene"


def natural(path: Path) -> list[tuple[int, str]]:
    """A key that sorts digits by value."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def only_image(folder: Path, stem: str) -> Path:
    """The one image ``folder/stem.*``.

    Raises
    ------
    EvalError
        If there is none, or several endings to choose from.
    """
    found = sorted(p for p in folder.glob(f"{stem}.*") if is_image(p))
    if len(found) != 1:
        names = [p.name for p in found] or "none"
        raise EvalError(f"{folder}: expected one image {stem}.* ({', '.join(IMAGE_ENDINGS)}), found {names}")
    return found[0]


def read_matrix(path: Path, shape: tuple[int, int]) -> Float:
    """Numbers in a text file, row by row.

    Raises
    ------
    EvalError
        If the file is missing, or does not hold that many finite numbers.
    """
    try:
        numbers = np.array(path.read_text(encoding="utf-8").split(), np.float64)
    except OSError as error:
        raise EvalError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise EvalError(f"{path}: not a matrix of numbers: {error}") from error
    if numbers.size != shape[0] * shape[1] or not np.isfinite(numbers).all():
        raise EvalError(f"{path}: expected a {shape[0]}x{shape[1]} matrix, found {numbers.size} numbers")
    return numbers.reshape(shape)


def read_homography(path: Path) -> Homography:
    """A 3x3 text file, scaled so that the last entry is 1.

    Raises
    ------
    EvalError
        As in `read_matrix`; also if the matrix is singular.
    """
    matrix = read_matrix(path, (3, 3))
    if matrix[2, 2] == 0.0 or abs(np.linalg.det(matrix / matrix[2, 2])) < 1e-12:
        raise EvalError(f"{path}: not a homography: the matrix is singular or its last entry 0")
    return Homography(tuple((matrix / matrix[2, 2]).ravel().tolist()))
