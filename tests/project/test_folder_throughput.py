"""benchmarks/folder_throughput.py runs: it goes below what the runtime makes public."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import cv2
import pytest

from helpers import ROOT, textured


def test_it_compares_and_measures_memory(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), (255 * textured(120, 160, number)).astype("uint8"))
    script = runpy.run_path(str(ROOT / "benchmarks" / "folder_throughput.py"))
    script["compare"](tmp_path, 1, [], None)
    said = capfd.readouterr().out
    assert said.startswith("3 images, ")
    rates = dict(re.findall(r"^(\S.*?) {2,}([\d.]+) images/s", said, re.MULTILINE))
    assert set(rates) == {"network alone", "detect, in memory", "elf-detect, files to files"}
    assert all(float(rate) > 0 for rate in rates.values())
