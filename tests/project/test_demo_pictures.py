"""Pictures of the documentation that `make demo` makes: what is there is what the commands draw today."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime.commands import detect, match
from helpers import ROOT
from project.test_code_runs import run_command

IMAGES = ROOT / "docs" / "images"
TITLE = 28  # rows of the line with the counts
VIEW = "out/demo/view.png"


@pytest.fixture
def demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the keypoints and the second view of `make demo`."""
    (tmp_path / "demo").symlink_to(ROOT / "demo", target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    assert detect.main(["demo/palace.jpg", "-o", "out", "--quiet"]) == 0
    run_command(("python", "demo/second_view.py", "demo/palace.jpg", VIEW), "make demo")
    return tmp_path


def difference(drawn: Path, shown: Path) -> tuple[float, float]:
    """The mean difference of two pictures of one size, and the share of clearly other pixels in the title."""
    a, b = (cv2.imread(str(path)) for path in (drawn, shown))
    assert a.shape == b.shape
    apart = cv2.absdiff(a, b)
    return float(apart.mean()), float((apart[:TITLE].max(axis=2) > 100).mean())


@pytest.mark.parametrize(
    ("drawn", "shown"), [("out/demo/palace.png", "keypoints.png"), ("out/demo/matches.png", "matches.png")]
)
def test_a_picture_is_what_the_demo_draws(
    drawn: str, shown: str, demo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["demo/palace.jpg", VIEW, "--ransac", "homography", "-o", "out/demo/matches.png"]
    assert match.main(words) == 0
    (line,) = capsys.readouterr().out.splitlines()
    counts = re.search(r"\d+ matches, \d+ homography inliers", line)
    assert counts
    if counts[0] not in (ROOT / "docs" / "commands.md").read_text(encoding="utf-8"):
        pytest.skip(f"this processor or OpenCV finds {counts[0]}, not those of docs/commands.md")
    mean, other = difference(demo / drawn, IMAGES / shown)
    assert mean < 3  # 256 colours make 1.5
    assert other == 0, "the title has other numbers"


def test_saliencies_of_models_can_be_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = str(ROOT / "runtime" / "elf_runtime" / "models" / "elf-vgg.onnx")
    monkeypatch.setattr("sys.argv", ["draw_networks.py", *[model] * 4, "--out", str(tmp_path / "networks.png")])
    runpy.run_path(str(ROOT / "tools" / "draw_networks.py"), run_name="__main__")
    drawn = cv2.imread(str(tmp_path / "networks.png")).astype(int)
    height = drawn.shape[0] // 2
    assert drawn.shape[1] > 4 * 420
    assert np.ptp(drawn[height + 40 :, :400]) > 200  # the photograph begins the second row
    assert np.array_equal(drawn[: height - 8, :420], drawn[: height - 8, 430:850])  # two panels of one model


def test_other_numbers_in_a_title_are_seen(tmp_path: Path) -> None:
    for name, text in (("a", "355 matches"), ("b", "354 matches")):
        picture = np.full((60, 300, 3), 24, np.uint8)
        cv2.putText(picture, text, (4, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (230, 230, 230), 1, cv2.LINE_AA)
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture)
    assert difference(tmp_path / "a.png", tmp_path / "a.png") == (0, 0)
    assert difference(tmp_path / "a.png", tmp_path / "b.png")[1] > 0
