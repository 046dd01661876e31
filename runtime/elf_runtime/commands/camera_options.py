"""The options that say what is known of cameras, which `elf-reconstruct` and `elf-localize` share."""

from __future__ import annotations

import argparse

import numpy as np

from elf_runtime.errors import SettingError
from elf_runtime.reconstruction.cameras import Calibration


def add_calibration_options(group: argparse._ActionsContainer) -> None:
    known = group.add_mutually_exclusive_group()
    known.add_argument(
        "--K", dest="calibration", type=_matrix, metavar="FX,FY,CX,CY",
        help="known intrinsics in pixels, as OpenCV's calibration gives them: (0, 0) is the centre of the first pixel",
    )  # fmt: skip
    known.add_argument(
        "--camera", dest="calibration", type=_camera, metavar="MODEL:P1,P2,...",
        help="known intrinsics as COLMAP has them, such as OPENCV:fx,fy,cx,cy,k1,k2,p1,p2: the centre of the first "
        "pixel is (0.5, 0.5)",
    )  # fmt: skip


def _matrix(text: str) -> Calibration:
    try:
        fx, fy, cx, cy = (float(number) for number in text.split(","))
        return Calibration.of_matrix(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]))
    except (ValueError, SettingError):
        raise argparse.ArgumentTypeError(f"{text!r} is not FX,FY,CX,CY, focal lengths above 0") from None


def _camera(text: str) -> Calibration:
    try:
        return Calibration.parse(text)
    except SettingError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
