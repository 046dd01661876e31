"""elf-detect where results already exist: what is kept, skipped or done again."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import Features
from runtime.commands.detecting import detect, write


def test_results_of_another_image_are_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = write(tmp_path / "a" / "1.png"), write(tmp_path / "b" / "1.png", 1)
    monkeypatch.chdir(first.parent)
    assert detect("1.png", "-o", "../out") == 0
    kept = {path: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    monkeypatch.chdir(second.parent)
    for options in ([], ["--skip-existing"], ["--no-picture"]):
        assert detect("1.png", "-o", "../out", *options) == 1
        assert f"1.npz holds the results of {first}; give another -o" in capsys.readouterr().err
        assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} == kept
    assert detect("1.png", "-o", "../out", "--overwrite") == 0
    assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} != kept


def test_skipping_and_overwriting_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "1.jpg"), tmp_path / "out"
    for said in (" keypoints", ": skipped, "):
        assert detect(image, "-o", out, "--skip-existing", "--overwrite") == 0
        assert said in capsys.readouterr().out


def test_a_file_of_somebody_else_s_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = write(tmp_path / "1.jpg")
    for name in ("1.npz", "1.csv", "1.png"):
        out = tmp_path / f"out-{name}"
        out.mkdir()
        (out / name).write_text("precious")
        assert detect(image, "-o", out) == 1
        assert f"{name} is no result of elf-detect" in capsys.readouterr().err
        assert [path.read_text() for path in out.iterdir()] == ["precious"]


def test_what_is_done_is_skipped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "1.jpg"), tmp_path / "out"

    def ran(*options: object) -> bool:
        before = (out / "1.npz").stat().st_mtime_ns if out.exists() else 0
        assert detect(image, "-o", out, "--skip-existing", *options) == 0
        again = (out / "1.npz").stat().st_mtime_ns != before
        assert (": skipped, " in capsys.readouterr().out) is not again
        return again

    assert ran()
    assert not ran()
    assert ran("--max-keypoints", 7)
    assert not ran("--max-keypoints", 7)
    cv2.imwrite(str(tmp_path / "mask.png"), np.full((96, 128), 255, np.uint8))
    assert ran("--max-keypoints", 7, "--mask", tmp_path / "mask.png")
    assert not ran("--max-keypoints", 7, "--mask", tmp_path / "mask.png")
    (out / "1.csv").unlink()
    assert ran("--max-keypoints", 7, "--mask", tmp_path / "mask.png")
    write(image, 1)
    assert ran("--max-keypoints", 7, "--mask", tmp_path / "mask.png")
    summary = tmp_path / "s.json"
    assert not ran("--max-keypoints", 7, "--mask", tmp_path / "mask.png", "--json", summary)
    assert json.loads(summary.read_text())["images"][0]["skipped"] is True


def test_an_interrupted_image_is_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image, out = write(tmp_path / "1.jpg"), tmp_path / "out"
    assert detect(image, "-o", out, "--max-keypoints", 3) == 0
    monkeypatch.setattr("elf_runtime.extraction.extractor.detection_picture", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        detect(image, "-o", out)
    monkeypatch.undo()
    assert not (out / "1.png").exists()  # it was of other settings
    assert detect(image, "-o", out, "--skip-existing") == 0
    assert len((out / "1.csv").read_text().splitlines()) == len(Features.load(out / "1.npz")) + 1 > 4
    assert (out / "1.png").exists()


def test_a_result_that_was_cut_off_is_done_again(tmp_path: Path) -> None:
    image, out = write(tmp_path / "1.jpg"), tmp_path / "out"
    assert detect(image, "-o", out) == 0
    whole = (out / "1.npz").read_bytes()
    (out / "1.npz").write_bytes(whole[:900])
    assert detect(image, "-o", out) == 1  # without a word on existing results nothing is replaced
    assert detect(image, "-o", out, "--skip-existing") == 0
    np.testing.assert_array_equal(Features.load(out / "1.npz").keypoints, load(whole, tmp_path).keypoints)


def load(data: bytes, folder: Path) -> Features:
    (folder / "whole.npz").write_bytes(data)
    return Features.load(folder / "whole.npz")
