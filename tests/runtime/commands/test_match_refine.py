"""elf-match --refine: the matched points of B by the pixels of both images, in the fit and in every file."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime, Matches, match, refine
from elf_runtime.commands import match_report, match_views
from elf_runtime.commands.detect import main as detect
from elf_runtime.commands.match import main
from elf_runtime.image.file import ImageFile, read
from elf_runtime.pictures.render import match_picture
from helpers import textured, turned_jpeg

ALONE = ["--threads", "1"]
NAMES = ["1.png", "2.png", "3.png"]
STEP = np.array([73, -51]) / 32  # pixels from one view to the next; OpenCV 4 warps in steps of 1/32


@pytest.fixture
def photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Views of a plane, each moved by STEP from the one before; OpenCV's cubic kernel would be 0.04 pixels off."""
    monkeypatch.chdir(tmp_path)
    Path("photos").mkdir()
    image = cv2.GaussianBlur(textured(200, 260), (0, 0), 1.0)
    for number, name in enumerate(NAMES):
        matrix = np.array([[1, 0, number * STEP[0]], [0, 1, number * STEP[1]]])
        moved = cv2.warpAffine(image, matrix, (260, 200), flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT)
        cv2.imwrite(f"photos/{name}", moved)
    return [f"photos/{name}" for name in NAMES]


def run(*arguments: str) -> int:
    return main([*arguments, *ALONE, "--ratio", "0.95"])


def saved(path: str) -> dict[str, Any]:
    with np.load(path) as file:
        return dict(file)


def off(found: dict[str, Any], shift: np.ndarray) -> float:
    """The median distance of B's points from where A's are by the true shift."""
    return float(np.median(np.linalg.norm(found["points_b"] - found["points_a"] - shift, axis=1)))


def test_points_of_b_are_where_refine_finds_them(
    photos: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []

    def spy(images: Any, points: Any, *rest: Any) -> Any:
        drawn.append(points[1])
        return match_picture(images, points, *rest)

    monkeypatch.setattr(match_report, "match_picture", spy)
    files = ["--ransac", "homography", "--save", "m.npz", "--json", "m.json", "-o", "m.png"]
    before, after = [], []
    for side, more in ((before, []), (after, ["--refine"])):
        assert run(*photos[:2], *files, *more) == 0
        side += [saved("m.npz"), json.loads(Path("m.json").read_text())]
    elf = ElfRuntime(threads=1)
    a, b = (elf.detect(name) for name in photos[:2])
    expected = refine(Matches.of(match(a, b, 0.95)), a, b, *photos[:2])
    np.testing.assert_array_equal(after[0]["points_b"], expected)
    assert {name for name in after[0] if not np.array_equal(after[0][name], before[0][name])} <= {
        "points_b", "inliers", "matrix"
    }  # fmt: skip
    assert off(after[0], STEP) < 0.05 < 0.15 < off(before[0], STEP)
    moved = int((after[0]["points_b"] != before[0]["points_b"]).any(axis=1).sum())
    assert (before[1]["refine"], before[1]["refined"]) == (False, None)
    assert (after[1]["refine"], after[1]["refined"]) == (True, moved)
    assert f"{len(expected)} matches ({moved} refined), " in capsys.readouterr().out
    errors = [np.abs(np.array(side[1]["matrix"])[:2, 2] - STEP).max() for side in (before, after)]
    assert errors[1] < 0.1 < errors[0]
    np.testing.assert_array_equal(drawn[1], expected)


def test_every_pair_of_a_folder(photos: list[str]) -> None:
    assert run("photos", "--refine", "--save", "out", "--json", "m.json") == 0
    pairs = json.loads(Path("m.json").read_text())["pairs"]
    assert all(0 < pair["refined"] <= pair["matches"] for pair in pairs)
    for i, j in combinations(range(3), 2):
        assert off(saved(f"out/{NAMES[i]}--{NAMES[j]}.npz"), (j - i) * STEP) < 0.1


def test_feature_files_go_by_the_images_that_they_name(photos: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*photos[:2], "--refine", "--save", "a.npz") == 0
    assert detect(["photos", "-o", "found", *ALONE]) == 0
    files = [f"found/photos/{Path(name).stem}.npz" for name in NAMES]
    assert main([*files[:2], "--ratio", "0.95", "--refine", "--save", "b.npz"]) == 0
    np.testing.assert_array_equal(saved("b.npz")["points_b"], saved("a.npz")["points_b"])
    Path(photos[1]).unlink()
    capsys.readouterr()
    assert main([*files[:2], "--refine", "--save", "c.npz"]) == 1
    assert (
        capsys.readouterr().err
        == f"elf-match: error: {files[1]}: its image {Path(photos[1]).absolute()} is not there\n"
    )
    assert not Path("c.npz").exists()
    assert main(["found/photos", "--refine", "--json", "m.json", "--quiet"]) == 1
    pairs = json.loads(Path("m.json").read_text())["pairs"]
    assert ["error" in pair for pair in pairs] == [True, False, True]


@pytest.mark.parametrize("stored", [[], ["--ignore-exif"]])
def test_images_are_turned_as_for_the_detection(photos: list[str], stored: list[str]) -> None:
    for name in photos[:2]:
        Path(name).write_bytes(turned_jpeg(cv2.imread(name)))
    assert run(*photos[:2], "--refine", "--save", "m.npz", *stored) == 0
    height, width = read(photos[0], ignore_exif=bool(stored)).shape[:2]
    shift = STEP if width > height else np.array([-STEP[1], STEP[0]])  # a quarter turn, clockwise
    assert off(saved("m.npz"), shift) < 0.15


def test_an_image_is_read_once_for_both_refinement_and_picture(
    photos: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []

    def counted(path: Path, *more: Any) -> Any:
        opened.append(str(path))
        return ImageFile(path, *more)

    monkeypatch.setattr(match_views, "ImageFile", counted)
    assert run("photos", "--pairs", "sequential:1", "--refine", "-o", "out") == 0
    assert sorted(opened) == sorted([*photos, *photos])  # once more for the detection


def test_of_a_feature_file_no_other_image_is_taken(photos: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert detect(["photos", "-o", "features", *ALONE, "--quiet"]) == 0
    files = [str(path) for path in sorted(Path("features").rglob("*.npz"))[:2]]
    assert main([*files, "--refine"]) == 0
    Path(photos[1]).write_bytes(Path(photos[2]).read_bytes())  # of the same size
    capsys.readouterr()
    for option in (["--refine"], ["-o", "drawn.png"]):
        assert main([*files, *option]) == 1
        assert "2.png: it is no longer the image that" in capsys.readouterr().err
    assert not Path("drawn.png").exists()


def test_an_image_too_wide_to_refine_by_does_not_end_the_others(
    photos: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    wide = np.random.default_rng(1).integers(0, 255, (40, 33000), np.uint8)
    for name in ("8.png", "9.png"):
        cv2.imwrite(f"photos/{name}", cv2.GaussianBlur(wide, (0, 0), 2))
    assert run("photos", "--refine", "--max-side", "4000", "--json", "found.json") == 1
    assert "has a side above 32766 pixels; matches can't be refined by it" in capsys.readouterr().err
    pairs = json.loads(Path("found.json").read_text())["pairs"]
    assert sum("error" in pair and pair["error"] is not None for pair in pairs) == 7
    assert len(pairs) == 10
