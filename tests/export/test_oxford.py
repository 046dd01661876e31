"""The paper's setting on the eight Oxford sequences, by the paper's protocol."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from elf_eval.cli import main
from elf_export import export_network
from helpers import shared


def test_the_paper_s_setting_on_oxford(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """rep 67.9, ms 46.9 at 253 keypoints a picture: measured beforehand, with torch, by another implementation."""
    data = shared("data", "oxford_affine")
    weights = shared("weights", "vgg16_oxford_imagenet.npz")
    monkeypatch.chdir(tmp_path)  # the model's path names the method in tables and plots
    export_network("vgg", "pool2", ["pool4"], "elf.onnx", weights=weights)
    arguments = ["run", "--dataset", f"hpatches:{data}", "--detector", "elf:elf.onnx?preset=paper"]
    assert main([*arguments, "--out", str(tmp_path / "out"), "--cache", str(tmp_path / "cache")]) == 0
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    scenes: dict[str, list[tuple[float, float]]] = {}
    for pair in results["pairs"]:
        scenes.setdefault(pair["scene"], []).append((pair["metrics"]["rep"], pair["metrics"]["ms"]))
    assert sorted(map(len, scenes.values())) == [5] * 8
    rep, ms = 100 * np.mean([np.mean(rows, axis=0) for rows in scenes.values()], axis=0)
    print(f"rep {rep:.1f}, ms {ms:.1f}")
    assert rep == pytest.approx(67.9, abs=1.5)
    assert ms == pytest.approx(46.9, abs=1.5)
