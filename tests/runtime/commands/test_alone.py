"""The commands with a file that gives keypoints itself."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import Features
from elf_runtime.commands import bench, detect, info, match, view
from helpers import TINY, TINY_ALONE, textured


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    cv2.imwrite(str(tmp_path / "a.png"), textured(120, 160))
    return tmp_path / "a.png"


def test_elf_detect(photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outs = []
    for model in (TINY, TINY_ALONE):
        out = tmp_path / model.stem
        words = [str(photo), "-o", str(out), "--model", str(model), "--max-keypoints", "4", "--explain"]
        assert detect.main([*words, "--json", str(tmp_path / "run.json")]) == 0
        outs.append(Features.load(out / "a.npz"))
        picture, sheet = cv2.imread(str(out / "a.png")), cv2.imread(str(out / "a.explain.png"))
        assert np.ptp(picture) > 100
        assert np.ptp(sheet) > 100
    wanted, found = outs
    assert len(found) == 4
    np.testing.assert_allclose(found.keypoints, wanted.keypoints, atol=0.01)
    summary = json.loads((tmp_path / "run.json").read_text())
    assert summary["images"][0]["passed"] is None
    capsys.readouterr()
    assert detect.main([str(photo), "-o", str(tmp_path / "x"), "--model", str(TINY_ALONE), "--scale", "0.5"]) == 2
    assert "scale can't be changed; max_keypoints, threshold and a mask can be given" in capsys.readouterr().err


def test_elf_info(capsys: pytest.CaptureFixture[str]) -> None:
    assert info.main([str(TINY_ALONE), "--provider", "cpu"]) == 0
    text = capsys.readouterr().out
    assert "the file gives keypoints itself, for an image of uint8 bgr; suppression by a Loop" in text
    assert "  network's input  float32 NHWC" in text
    assert "CPU              runs every op" in text


def test_elf_match_and_elf_view(photo: Path, tmp_path: Path) -> None:
    words = [str(photo), str(photo), "--model", str(TINY_ALONE), "--output", str(tmp_path / "m.png"), "--quiet"]
    assert match.main(words) == 0
    page = tmp_path / "page.html"
    assert view.main([str(photo.parent), "--model", str(TINY_ALONE), "-o", str(page), "--quiet"]) == 0
    assert "a file that gives keypoints itself: the keypoints are those of elf-detect" in page.read_text()


def test_elf_bench(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--model", str(TINY_ALONE), "--sizes", "64x96,80x64", "--repeats", "1", "--warmup", "1", "--threads", "1"]
    words += ["--processes", "1"]
    assert bench.main([*words, "--json", str(tmp_path / "b.json")]) == 0
    text = capsys.readouterr().out
    assert "left out: torch: the model gives keypoints itself" in text
    for entry in json.loads((tmp_path / "b.json").read_text())["sizes"]:
        seconds, stages = entry["seconds"], {"read", "prepare", "session", "detect + describe"}
        assert {name for name in seconds if name.startswith("elf")} == {"elf", *(f"elf.{stage}" for stage in stages)}
        assert "elf.detect + describe / sift" in entry["ratios"]
    assert bench.main([*words, "--peers", "torch"]) == 2
    assert "has no saliency to compare" in capsys.readouterr().err
