"""The options that say what is known of cameras, which `elf-reconstruct` and `elf-localize` share."""

from __future__ import annotations

import argparse
from pathlib import Path

from elf_runtime.errors import ElfError
from elf_runtime.extraction.frames import Still
from elf_runtime.reconstruction.cameras import Calibration, Size
from elf_runtime.reconstruction.database import check_calibration

from .command import UsageError
from .match_cameras import Intrinsics, parse_camera

Given = Calibration | Intrinsics


def add_calibration_options(group: argparse._ActionsContainer) -> None:
    known = group.add_mutually_exclusive_group()
    known.add_argument(
        "--K", metavar="CAMERA",
        help="known intrinsics, as OpenCV's calibration gives them: fx,fy,cx,cy in pixels, one focal length, or a file "
        "of these or of a 3x3 matrix. (0, 0) is the centre of the first pixel; without cx,cy the middle is taken",
    )  # fmt: skip
    known.add_argument(
        "--camera", metavar="MODEL:P1,P2,...",
        help="known intrinsics as COLMAP has them, such as OPENCV:fx,fy,cx,cy,k1,k2,p1,p2: the centre of the first "
        "pixel is (0.5, 0.5)",
    )  # fmt: skip


def read_calibration(args: argparse.Namespace) -> Given | None:
    """What --K or --camera say; None where neither is given.

    Raises
    ------
    UsageError, SettingError, ElfError
        See `parse_camera` and `Calibration.parse`; on a matrix with skew, which COLMAP's cameras do not have.
    """
    if args.camera is not None:
        return Calibration.parse(args.camera)
    if args.K is None:
        return None
    found = parse_camera("--K", args.K)
    if found.skew:
        raise UsageError(f"--K {args.K}: COLMAP's cameras have no skew, and this one's is {found.skew:g}")
    return found


def calibration_of(given: Given | None, size: Size) -> Calibration | None:
    """Of images of (height, width) pixels."""
    return Calibration.of_matrix(given.matrix(size)) if isinstance(given, Intrinsics) else given


def check_first(given: Given | None, image: Path) -> None:
    """Refuse what COLMAP does not take for an image, by its header and before any work; needs pycolmap.

    Raises
    ------
    UsageError
        With the reason, see `check_calibration`.
    """
    size = Still(image, image).size()
    try:
        if isinstance(given, Calibration):
            check_calibration(given, size)
        elif given is not None and size is not None:
            check_calibration(Calibration.of_matrix(given.matrix(size)), size)
    except ElfError as error:
        raise UsageError(str(error)) from error
