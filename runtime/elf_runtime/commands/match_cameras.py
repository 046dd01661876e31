"""Cameras of images: what --K says of them, in every command."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ElfError, reason
from elf_runtime.files.kind import open_regular

from .command import UsageError

Float = npt.NDArray[np.float64]
_MOST_BYTES = 1 << 16  # of a file of a matrix


@dataclass(frozen=True)
class Intrinsics:
    """A camera as it is given: fx, fy, cx, cy and skew in pixels, or a focal length alone.

    Attributes
    ----------
    focal : (fx, fy)
    centre : (cx, cy), optional
        By default the middle of the image.
    skew : float
    """

    focal: tuple[float, float]
    centre: tuple[float, float] | None = None
    skew: float = 0.0

    def matrix(self, size: tuple[int, int]) -> Float:
        """The calibration matrix (3, 3) of an image of (height, width) pixels; integer = pixel centre.

        Raises
        ------
        ElfError
            If the principal point is further outside the image than half its width or height.
        """
        height, width = size
        (fx, fy), (cx, cy) = self.focal, self.centre or ((width - 1) / 2, (height - 1) / 2)
        if abs(cx - (width - 1) / 2) > width or abs(cy - (height - 1) / 2) > height:
            raise ElfError(
                f"--K: the principal point {cx:g},{cy:g} lies far outside an image of {width}x{height} pixels"
            )
        return np.array([[fx, self.skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def parse_camera(option: str, text: str) -> Intrinsics:
    """What ``fx,fy,cx,cy``, ``f``, or a file of these or of a 3x3 matrix says.

    Raises
    ------
    UsageError
        If it is none of these, or no calibration.
    ElfError
        If the file can't be read.
    """
    numbers = _numbers(text)
    if numbers is None:
        path = Path(text)
        if not text.strip() or not path.exists():
            raise UsageError(f"{option} {text}: not fx,fy,cx,cy, not one focal length, and no file of this name")
        try:
            with open_regular(path) as file:
                numbers = _numbers(re.sub("#.*", "", file.read(_MOST_BYTES).decode("utf-8-sig")))
        except (OSError, UnicodeDecodeError) as error:
            raise ElfError(f"{option}: {path}: {reason(error)}") from error
    found = None if numbers is None else _intrinsics(numbers)
    if found is None or not (np.isfinite(numbers or []).all() and min(found.focal) > 0):
        raise UsageError(
            f"{option} {text}: a camera is fx,fy,cx,cy in pixels, one focal length, or a file of these or of a "
            "3x3 matrix [[fx, s, cx], [0, fy, cy], [0, 0, 1]]"
        )
    return found


def _numbers(text: str) -> list[float] | None:
    """The numbers of a text, between commas, brackets and white space; None where something else is there."""
    words = re.split(r"[\s,;\[\]]+", text.strip(" \t\r\n,;[]"))
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def _intrinsics(numbers: Sequence[float]) -> Intrinsics | None:
    if len(numbers) == 1:
        return Intrinsics((numbers[0], numbers[0]))
    if len(numbers) == 4:
        return Intrinsics((numbers[0], numbers[1]), (numbers[2], numbers[3]))
    if len(numbers) == 9 and (numbers[3], *numbers[6:]) == (0.0, 0.0, 0.0, 1.0):
        return Intrinsics((numbers[0], numbers[4]), (numbers[2], numbers[5]), numbers[1])
    return None
