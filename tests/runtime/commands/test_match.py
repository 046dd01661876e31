"""elf-match: counts, inliers, files."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime
from elf_runtime import match as matched
from elf_runtime.commands.bench_workloads import synthetic
from elf_runtime.commands.match import main
from elf_runtime.geometry.fit import fit
from elf_runtime.image import read
from helpers import TINY, turned_jpeg

SHIFT = (16, 8)  # a multiple of the network's stride, so that it sees the same


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """Two views of one plane, the second moved by SHIFT."""
    scene = synthetic(240, 320)
    first, second = scene[: 240 - SHIFT[1], : 320 - SHIFT[0]], scene[SHIFT[1] :, SHIFT[0] :]
    cv2.imwrite(str(tmp_path / "a.png"), first)
    cv2.imwrite(str(tmp_path / "b.png"), second)
    return tmp_path / "a.png", tmp_path / "b.png"


def match(*arguments: object) -> int:
    return main([str(a) for a in arguments] + ["--model", str(TINY), "--threads", "1", "--threshold", "none"])


def test_draws_and_counts(pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert match(*pair, "-o", tmp_path / "m.png") == 0
    assert cv2.imread(str(tmp_path / "m.png")) is not None
    assert "matches" in capsys.readouterr().out


def test_ransac_finds_the_shift(pair: tuple[Path, Path], tmp_path: Path) -> None:
    files = ["--save", tmp_path / "m.npz", "--json", tmp_path / "m.json"]
    assert match(*pair, "-o", tmp_path / "m.jpg", "--ransac", "homography", *files) == 0
    summary = json.loads((tmp_path / "m.json").read_text())
    assert summary["inliers"] >= 0.6 * summary["matches"] > 10
    matrix = np.array(summary["matrix"]) / summary["matrix"][2][2]
    np.testing.assert_allclose(matrix[:2, 2], (-SHIFT[0], -SHIFT[1]), atol=1.0)
    with np.load(tmp_path / "m.npz") as saved:
        assert saved["inliers"].sum() == summary["inliers"]
        moved = saved["points_b"] - saved["points_a"]
        assert saved["pairs"].shape == (summary["matches"], 2)
        assert np.abs(moved[saved["inliers"]] + SHIFT).max() <= 3.0
        np.testing.assert_allclose(saved["matrix"], summary["matrix"])
        for name in ("scores", "sizes", "angles"):
            assert saved[f"{name}_a"].shape == saved[f"{name}_b"].shape == (summary["matches"],)


def test_without_a_fit_every_match_is_an_inlier(pair: tuple[Path, Path], tmp_path: Path) -> None:
    assert match(*pair, "-o", tmp_path / "m.png", "--save", tmp_path / "m.npz") == 0
    with np.load(tmp_path / "m.npz") as saved:
        assert len(saved["inliers"]) == len(saved["pairs"]) > 0
        assert saved["inliers"].all()
        assert np.isnan(saved["matrix"]).all()


def test_the_inlier_distance_reaches_the_fit(
    pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[tuple[object, ...]] = []

    def spy(*arguments: Any) -> Any:
        given.append((arguments[2], arguments[3].threshold))
        return fit(*arguments)

    monkeypatch.setattr("elf_runtime.commands.match_run.fit", spy)
    for more, wanted in (((), 3.0), (("--ransac-threshold", 0.5), 0.5)):
        assert match(*pair, "-o", tmp_path / "m.png", "--ransac", "homography", *more) == 0
        assert given.pop() == ("homography", wanted)


def test_a_fundamental_matrix_and_the_ratio_test(pair: tuple[Path, Path], tmp_path: Path) -> None:
    counts = []
    for ratio in ("0.99", "0.7"):
        options = ["--ransac", "fundamental", "--ransac-threshold", "1.5", "--ratio", ratio]
        assert match(*pair, "-o", tmp_path / "m.png", *options, "--json", tmp_path / "m.json") == 0
        counts.append(json.loads((tmp_path / "m.json").read_text())["matches"])
    assert 0 < counts[1] < counts[0]


def test_nothing_to_match_is_no_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flat = tmp_path / "flat.png"
    cv2.imwrite(str(flat), np.full((64, 80), 90, np.uint8))
    files = ["--save", tmp_path / "m.npz"]
    assert match(flat, flat, "-o", tmp_path / "m.png", "--ransac", "homography", *files) == 0
    assert "0 matches, no homography" in capsys.readouterr().out
    with np.load(tmp_path / "m.npz") as saved:
        assert saved["pairs"].shape == (0, 2)
        assert np.isnan(saved["matrix"]).all()


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        (["-o", "m.png", "--ransac-threshold", "2"], 2, "needs --ransac"),
        (["-o", "m.png", "--ratio", "1.5"], 2, "--ratio 1.5"),
        (["-o", "m.png", "--save", "m.txt"], 2, ".npz"),
        (["-o", "m.png", "--ransac", "homography", "--ransac-threshold", "-1"], 2, "--ransac-threshold -1"),
        (["-o", "m.png", "--ransac", "homography", "--ransac-threshold", "0"], 2, "--ransac-threshold 0"),
        (["-o", "m.png", "--ransac", "fundamental", "--ransac-threshold", "nan"], 2, "--ransac-threshold nan"),
        (["-o", "m.xyz"], 2, ".xyz"),
        (["-o", "a.png"], 2, "input image"),
        (["-o", "absent/m.png"], 1, "-o: there is no folder absent"),
        (["-o", "m.png", "--json", "link.json"], 2, "--json: link.json is an input image"),
        (["-o", "a.png", "--mask", "m.png"], 2, "-o: a.png is an input image"),
        (["-o", "m.png", "--json", "absent/m.json"], 1, "--json: there is no folder absent"),
        (["-o", "m.png", "--save", "absent/m.npz"], 1, "--save: there is no folder absent"),
    ],
)
def test_one_line_for_what_is_wrong(
    pair: tuple[Path, Path],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    status: int,
    reason: str,
) -> None:
    monkeypatch.chdir(pair[0].parent)
    monkeypatch.setattr(ElfRuntime, "detect", None)  # no image gets that far
    Path("link.json").symlink_to("a.png")
    before = {p.name: p.read_bytes() for p in pair[0].parent.iterdir()}
    assert match("a.png", "b.png", *arguments) == status
    error = capsys.readouterr().err
    assert error.startswith("elf-match: error: ")
    assert error.count("\n") == 1
    assert reason in error
    assert {p.name: p.read_bytes() for p in pair[0].parent.iterdir()} == before


def test_a_missing_image_is_named(pair: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert match(pair[0], "absent.png", "-o", pair[0].parent / "m.png") == 1
    assert "absent.png" in capsys.readouterr().err


def test_settings_and_stored_pixels_reach_the_detector(pair: tuple[Path, Path], tmp_path: Path) -> None:
    for path in pair:
        path.write_bytes(turned_jpeg(cv2.imread(str(path))))
    more = ["--set", "max_keypoints=40", "--ignore-exif"]
    assert match(*pair, "-o", tmp_path / "m.png", "--save", tmp_path / "m.npz", *more) == 0
    elf = ElfRuntime(TINY, threads=1)
    first, second = (elf.detect(read(path, ignore_exif=True), threshold="none", max_keypoints=40) for path in pair)
    with np.load(tmp_path / "m.npz") as saved:
        np.testing.assert_array_equal(saved["pairs"], matched(first, second))
        np.testing.assert_array_equal(saved["points_a"], first.keypoints[saved["pairs"][:, 0]])
    assert main(["a", "b", "-o", str(tmp_path / "n.png"), "--set", "sale=1"]) == 2


def test_without_a_picture(pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(tmp_path.iterdir())
    assert match(*pair, "--json", "-", "--ratio", "0.95", "--max-keypoints", "60") == 0
    said = capsys.readouterr()
    summary = json.loads(said.out)
    assert said.err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before
    assert [image["image"] for image in summary["images"]] == [str(path) for path in pair]
    assert [image["sha256"] for image in summary["images"]] == [
        hashlib.sha256(path.read_bytes()).hexdigest() for path in pair
    ]
    assert all(0 < image["keypoints"] <= 60 for image in summary["images"])
    assert (summary["model"], summary["network"], summary["layer"]) == (str(TINY), "tiny", "pool1")
    assert summary["model_sha256"] == hashlib.sha256(TINY.read_bytes()).hexdigest()
    assert summary["ratio"] == 0.95
    assert (summary["settings"]["max_keypoints"], summary["settings"]["threshold"]) == (60, "none")
    assert match(*pair) == 0
    assert "matches\n" in capsys.readouterr().out


def test_a_chance_geometry_is_not_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    for name in "ab":
        cv2.imwrite(str(tmp_path / f"{name}.png"), rng.integers(0, 256, (240, 320, 3), np.uint8))
    for kind in ("homography", "fundamental"):
        files = ["-o", tmp_path / "m.png", "--save", tmp_path / "m.npz", "--json", tmp_path / "m.json"]
        assert match(tmp_path / "a.png", tmp_path / "b.png", "--ransac", kind, *files) == 0
        assert f", no {kind} that they support: " in capsys.readouterr().out
        summary = json.loads((tmp_path / "m.json").read_text())
        assert summary["supported"] is False
        assert summary["matrix"] is None
        assert summary["expected_by_chance"] > 1e-3
        with np.load(tmp_path / "m.npz") as saved:
            assert np.isnan(saved["matrix"]).all()
            assert not saved["inliers"].any()


def test_says_which_image_is_too_small(pair: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(pair[1]), np.zeros((8, 8), np.uint8))
    assert match(*pair) == 1
    assert f"{pair[1]}: the image has 8x8 pixels; the smallest is" in capsys.readouterr().err


def test_max_pixels_raises_the_limit(
    pair: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(ElfRuntime.__init__.__kwdefaults__, "max_pixels", 1000)  # the default
    assert match(*pair, "--max-pixels", 100_000) == 0
    assert match(*pair, "--max-pixels", 70_000) == 1
    assert "more than the limit of 70,000" in capsys.readouterr().err


def test_a_mask_holds_the_keypoints_of_both_images(pair: tuple[Path, Path], tmp_path: Path) -> None:
    mask = np.zeros(cv2.imread(str(pair[0])).shape[:2], np.uint8)
    mask[:, : mask.shape[1] // 2] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    assert match(*pair, "--mask", tmp_path / "mask.png", "--save", tmp_path / "m.npz") == 0
    with np.load(tmp_path / "m.npz") as found:
        assert len(found["pairs"]) > 0
        for name in ("points_a", "points_b"):
            assert (found[name][:, 0] < mask.shape[1] // 2).all()


def test_quiet_says_nothing(pair: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert match(*pair, "--quiet") == 0
    assert capsys.readouterr() == ("", "")
