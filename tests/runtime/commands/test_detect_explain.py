"""``elf-detect --explain``: the sheet beside the results, which is no image of a later run."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime.commands.detect import main
from elf_runtime.commands.inputs import image_files
from helpers import textured


def test_a_sheet_is_written_beside_the_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(120, 160))
    cv2.imwrite(str(tmp_path / "a.jpg"), textured(120, 160))
    out = tmp_path / "out"
    words = [str(tmp_path / "a.png"), "-o", str(out), "--explain", "--no-picture"]
    assert main(words) == 0
    assert sorted(path.name for path in out.iterdir()) == ["a.png.csv", "a.png.explain.png", "a.png.npz"]
    sheet = cv2.imread(str(out / "a.png.explain.png"))
    assert sheet.shape[1] > 3 * 200
    assert np.ptp(sheet) > 100
    assert main([*words, "--skip-existing"]) == 0
    assert "skipped" in capsys.readouterr().out
    (out / "a.png.explain.png").unlink()
    assert main([*words, "--skip-existing"]) == 0
    assert (out / "a.png.explain.png").is_file()


def test_a_sheet_is_no_image_of_a_later_run(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(120, 160))
    assert main(["-q", str(tmp_path / "a.png"), "-o", str(tmp_path / "out"), "--explain"]) == 0
    cv2.imwrite(str(tmp_path / "out" / "b.png"), textured(120, 160, seed=1))
    assert [path.name for path in image_files([str(tmp_path / "out")])] == ["b.png"]


def test_sheets_do_not_go_where_images_are_taken_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(120, 160))
    assert main([str(tmp_path), "-o", str(tmp_path), "--explain", "--no-picture"]) == 2
    assert "would be taken for images" in capsys.readouterr().err
