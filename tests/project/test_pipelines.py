"""The scripts for COLMAP and hloc write what these read."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime, Features, match
from elf_runtime.image import read
from helpers import ROOT, textured, turned_jpeg
from project.example_inputs import EXAMPLES, PICTURE


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> dict[Path, Features]:
    """Two views, 16 columns apart, with their features in stored pixels; noise makes some of the matches doubtful."""
    folder, scene = tmp_path_factory.mktemp("photos"), textured(120, 176)
    noisy = np.clip(scene + np.random.default_rng(0).normal(0, 40, scene.shape), 0, 255).astype(np.uint8)
    paths = [folder / "a.jpg", folder / "sub" / "b.jpg"]
    paths[1].parent.mkdir()
    paths[0].write_bytes(turned_jpeg(scene[:, 16:]))
    paths[1].write_bytes(turned_jpeg(noisy[:, :-16], 1))
    elf = ElfRuntime()
    settings = {"preset": "accurate", "max_keypoints": 2000}
    return {path: elf.detect(read(path, ignore_exif=True), **settings) for path in paths}


def converted(script: str, folder: Path, out: Path, *options: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
    command = [sys.executable, str(EXAMPLES / "pipelines" / script), str(folder), str(out), *options]
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False)


RATIOS = pytest.mark.parametrize(
    ("options", "ratio"), [([], 0.9), (["--ratio", "0.7"], 0.7), (["--ratio", "none"], None)]
)


@RATIOS
def test_colmap_s_text_files_hold_the_keypoints_and_the_matches(
    photos: dict[Path, Features], tmp_path: Path, options: list[str], ratio: float | None
) -> None:
    done = converted("to_colmap.py", next(iter(photos)).parent, tmp_path / "out", *options)
    assert done.returncode == 0, done.stderr
    a, b = photos.values()
    for name, features in zip(("a.jpg", "sub/b.jpg"), (a, b), strict=True):
        header, *lines = (tmp_path / "out" / "features" / f"{name}.txt").read_text().splitlines()
        assert header == f"{len(features)} 128"
        rows = np.array([line.split(" ") for line in lines], np.float64)
        assert rows.shape == (len(features), 4 + 128)
        np.testing.assert_allclose(rows[:, :2], features.keypoints + 0.5, atol=1e-3)
        assert (rows[:, 2:] == [1] + [0] * 129).all()
    names, *lines, blank = (tmp_path / "out" / "matches.txt").read_text().split("\n")[:-1]
    assert (names, blank) == ("a.jpg sub/b.jpg", "")
    assert len(lines) > 10
    assert [list(map(int, line.split())) for line in lines] == match(a, b, ratio=ratio).tolist()
    assert (len(lines) < len(match(a, b))) == (ratio is not None)


@pytest.mark.parametrize("script", ["to_colmap.py", "to_hloc.py"])
@pytest.mark.parametrize("ratio", ["0", "1", "nan", "high"])
def test_a_ratio_is_a_number_below_one(script: str, ratio: str, photos: dict[Path, Features], tmp_path: Path) -> None:
    if script == "to_hloc.py":
        pytest.importorskip("h5py")
    done = converted(script, next(iter(photos)).parent, tmp_path / "out", "--ratio", ratio)
    assert done.returncode == 2
    assert "error: argument --ratio: " in done.stderr.splitlines()[-1]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("script", ["to_colmap.py", "to_hloc.py"])
@pytest.mark.parametrize(
    ("files", "message"),
    [
        (["z.jpg", "a b.jpg"], "a b.jpg: "),
        ([], "{folder}: no .jpg, .jpeg or .png file in this folder or below it"),
    ],
)
def test_folders_that_neither_script_takes(script: str, files: list[str], message: str, tmp_path: Path) -> None:
    if script == "to_hloc.py":
        pytest.importorskip("h5py")
    (tmp_path / "in").mkdir()
    for name in files:
        cv2.imwrite(str(tmp_path / "in" / name), PICTURE)
    done = converted(script, tmp_path / "in", tmp_path / "out")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr.startswith(message.format(folder=tmp_path / "in"))
    assert not (tmp_path / "out").exists()


def test_hloc_has_one_name_for_files_that_differ_by_a_slash(tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    (tmp_path / "in" / "a").mkdir(parents=True)
    for name in ("a/c.jpg", "a-c.jpg"):
        cv2.imwrite(str(tmp_path / "in" / name), PICTURE)
    done = converted("to_hloc.py", tmp_path / "in", tmp_path / "out")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr.startswith("a-c.jpg: hloc writes / as -")
    assert not (tmp_path / "out").exists()


@RATIOS
def test_hloc_s_files_hold_the_keypoints_and_the_matches(
    photos: dict[Path, Features], tmp_path: Path, options: list[str], ratio: float | None
) -> None:
    h5py = pytest.importorskip("h5py")
    done = converted("to_hloc.py", next(iter(photos)).parent, tmp_path / "out", *options)
    assert done.returncode == 0, done.stderr
    a, b = photos.values()
    assert (tmp_path / "out" / "pairs.txt").read_text() == "a.jpg sub/b.jpg\n"
    with h5py.File(tmp_path / "out" / "features.h5", "r") as file:
        for name, features in zip(("a.jpg", "sub/b.jpg"), (a, b), strict=True):
            np.testing.assert_array_equal(file[name]["keypoints"], features.keypoints)
            np.testing.assert_array_equal(file[name]["scores"], features.scores)
            np.testing.assert_array_equal(file[name]["sizes"], features.sizes)
            np.testing.assert_array_equal(file[name]["angles"], features.angles)
            np.testing.assert_array_equal(file[name]["descriptors"], features.descriptors.T)
            assert file[name]["image_size"][:].tolist() == [160, 120]
    with h5py.File(tmp_path / "out" / "matches.h5", "r") as file:
        partners, scores = (file["a.jpg/sub-b.jpg"][key][:] for key in ("matches0", "matching_scores0"))
    assert len(partners) == len(scores) == len(a)
    matched = np.flatnonzero(partners != -1)
    assert len(matched) > 10
    assert np.stack([matched, partners[matched]], 1).tolist() == match(a, b, ratio=ratio).tolist()
    cosines = np.sum(a.descriptors[matched] * b.descriptors[partners[matched]], axis=1)
    np.testing.assert_allclose(scores[matched], cosines, rtol=0, atol=2e-6)  # float32 sums, in another order
    assert (scores[partners == -1] == 0).all()


def test_the_page_on_pipelines_lets_photographs_share_their_camera() -> None:
    page = (ROOT / "docs" / "pipelines.md").read_text(encoding="utf-8")
    command = page.split("colmap feature_importer", 1)[1].split("colmap matches_importer")[0]
    assert "--ImageReader.single_camera 1" in command
    assert "camera_mode=pycolmap.CameraMode.SINGLE" in page.split("reconstruction.main(", 1)[1].split("```")[0]
