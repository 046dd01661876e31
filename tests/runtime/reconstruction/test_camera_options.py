"""--K means the same in every command: one focal length, fx,fy,cx,cy, or a file."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from elf_runtime.commands.camera_options import calibration_of, read_calibration
from elf_runtime.commands.match_cameras import parse_camera
from elf_runtime.reconstruction import Calibration

SIZE = (480, 640)


def calibration(k: str | None, camera: str | None = None) -> Calibration | None:
    return calibration_of(read_calibration(argparse.Namespace(K=k, camera=camera)), SIZE)


@pytest.mark.parametrize("form", ["focal", "four", "file of four", "matrix"])
def test_the_forms_of_k(form: str, tmp_path: Path) -> None:
    """The principal point is half a pixel further in COLMAP's convention; of a focal length alone it is the middle."""
    four, matrix = tmp_path / "four.txt", tmp_path / "matrix.txt"
    four.write_text("828, 830, 319.5, 239.5  # OpenCV\n")
    np.savetxt(matrix, [[828, 0, 319.5], [0, 830, 239.5], [0, 0, 1]])
    text = {"focal": "828", "four": "828,830,319.5,239.5", "file of four": str(four), "matrix": str(matrix)}[form]
    fy = 828.0 if form == "focal" else 830.0
    assert calibration(text) == Calibration("PINHOLE", (828.0, fy, 320.0, 240.0))
    np.testing.assert_array_equal(parse_camera("--K", text).matrix(SIZE), [[828, 0, 319.5], [0, fy, 239.5], [0, 0, 1]])


def test_colmap_s_own_form_and_none() -> None:
    assert calibration(None, "simple_pinhole:828,320,240") == Calibration("SIMPLE_PINHOLE", (828.0, 320.0, 240.0))
    assert calibration(None) is None
