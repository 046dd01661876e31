"""The examples in other languages give what Python's ONNX Runtime gives, where their tools are installed; the scripts
for COLMAP and hloc write what these read.

``$ELF_NODE_MODULES`` may name a folder with npm's onnxruntime-web, ``$ELF_ORT`` one with ONNX Runtime's include and
lib folders.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from elf_runtime import ElfRuntime, Features, match
from elf_runtime.image import read
from elf_runtime.model import bundled_model
from elf_runtime.model.session import open_session
from helpers import ROOT, textured, turned_jpeg

EXAMPLES = ROOT / "examples"
PICTURE = textured(96, 130)


@pytest.fixture(scope="module")
def wanted() -> dict[str, npt.NDArray[np.float32]]:
    session, _ = open_session(bundled_model())
    names = [output.name for output in session.get_outputs()]
    values = session.run(names, {"image": PICTURE[None].astype(np.float32)})
    return dict(zip(names, values, strict=True))


@pytest.fixture
def ppm(tmp_path: Path) -> Path:
    path = tmp_path / "picture.ppm"
    cv2.imwrite(str(path), PICTURE)
    return path


def run(*command: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*map(str, command)], cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def web(tmp_path: Path) -> Path:
    """The example's folder, with its packages beside it."""
    modules = Path(os.environ.get("ELF_NODE_MODULES", EXAMPLES / "web" / "node_modules"))
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    if not (modules / "onnxruntime-web").is_dir():
        pytest.skip("npm's onnxruntime-web is not installed (npm install in examples/web)")
    folder = tmp_path / "web"
    folder.mkdir()
    shutil.copy(EXAMPLES / "web" / "saliency.mjs", folder)
    shutil.copy(EXAMPLES / "web" / "package.json", folder)
    (folder / "node_modules").symlink_to(modules.resolve(), target_is_directory=True)
    return folder


def test_webassembly_gives_the_same_maps(web: Path, ppm: Path, wanted: dict[str, npt.NDArray[np.float32]]) -> None:
    done = run("node", "saliency.mjs", bundled_model(), ppm, "found.json", folder=web)
    assert done.returncode == 0, done.stderr
    found = json.loads((web / "found.json").read_text(encoding="utf-8"))
    assert found.keys() == wanted.keys()
    for name, value in wanted.items():
        assert found[name]["dims"] == list(value.shape)
        error = np.abs(np.reshape(found[name]["data"], value.shape) - value) / value.max()
        # A ReLU or a pooling window may switch between two float32 implementations, at a few places.
        assert np.median(error) < 1e-5
        assert np.quantile(error, 0.99) < 1e-2
    y, x = np.unravel_index(wanted["saliency"][0].argmax(), PICTURE.shape[:2])
    assert f"at x {x}, y {y}" in done.stdout


def test_the_web_example_says_what_is_wrong(web: Path, ppm: Path) -> None:
    assert run("node", "saliency.mjs", folder=web).returncode == 2
    ppm.write_bytes(ppm.read_bytes()[:500])
    done = run("node", "saliency.mjs", bundled_model(), ppm, folder=web)
    assert done.returncode != 0
    assert "the picture is cut off" in done.stderr


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The C example, compiled."""
    for tool in ("make", "cc"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    given = os.environ.get("ELF_ORT")
    packaged = shutil.which("pkg-config") and run("pkg-config", "libonnxruntime", folder=ROOT).returncode == 0
    if not (given or packaged):
        pytest.skip("ONNX Runtime's C headers are not installed (libonnxruntime-dev, or name them in $ELF_ORT)")
    folder = tmp_path_factory.mktemp("c")
    for name in ("main.c", "Makefile"):
        shutil.copy(EXAMPLES / "c" / name, folder)
    flags = "CFLAGS=-O2 -Wall -Wextra -Werror"
    done = run("make", flags, *([f"ORT={given}"] if given else []), folder=folder)
    assert done.returncode == 0, done.stderr
    return folder / "elf"


def test_c_finds_the_same_maxima(program: Path, ppm: Path, wanted: dict[str, npt.NDArray[np.float32]]) -> None:
    saliency = wanted["saliency"][0]
    ys, xs = np.nonzero(saliency == cv2.dilate(saliency, np.ones((11, 11), np.uint8)))
    order = np.argsort(-saliency[ys, xs])[:12]
    done = run(program, bundled_model(), ppm, "12", folder=program.parent)
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines()]
    assert [(int(x), int(y)) for x, y, _ in rows] == [(xs[i], ys[i]) for i in order]
    assert [float(value) for *_, value in rows] == pytest.approx(
        [float(saliency[ys[i], xs[i]]) for i in order], rel=1e-3
    )


def test_the_readme_shows_what_c_finds() -> None:
    image = cv2.imread(str(ROOT / "demo" / "palace.jpg"))
    session, _ = open_session(bundled_model("fp32"))
    saliency = session.run(["saliency"], {"image": image[None].astype(np.float32)})[0][0]
    ys, xs = np.nonzero(saliency == cv2.dilate(saliency, np.ones((11, 11), np.uint8)))
    order = np.argsort(-saliency[ys, xs])
    rows = re.findall(r"^ +(\d+) (\d+) ([\d.]+)$", (EXAMPLES / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(rows) >= 2
    assert [(int(x), int(y)) for x, y, _ in rows] == [(xs[i], ys[i]) for i in order[: len(rows)]]
    values = [float(saliency[ys[i], xs[i]]) for i in order[: len(rows)]]
    assert [float(value) for *_, value in rows] == pytest.approx(values, rel=1e-3)


def test_the_c_example_says_what_is_wrong(program: Path, ppm: Path, tmp_path: Path) -> None:
    assert run(program, folder=tmp_path).returncode == 2
    assert run(program, bundled_model(), "absent.ppm", folder=tmp_path).stderr == "elf: absent.ppm: can't be opened\n"
    (tmp_path / "text.onnx").write_text("text")
    assert run(program, "text.onnx", ppm, folder=tmp_path).returncode == 1
    ppm.write_bytes(ppm.read_bytes()[:500])
    assert "cut off" in run(program, bundled_model(), ppm, folder=tmp_path).stderr


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
            np.testing.assert_array_equal(file[name]["descriptors"], features.descriptors.T)
            assert file[name]["image_size"][:].tolist() == [160, 120]
    with h5py.File(tmp_path / "out" / "matches.h5", "r") as file:
        partners, scores = (file["a.jpg/sub-b.jpg"][key][:] for key in ("matches0", "matching_scores0"))
    assert len(partners) == len(scores) == len(a)
    matched = np.flatnonzero(partners != -1)
    assert len(matched) > 10
    assert np.stack([matched, partners[matched]], 1).tolist() == match(a, b, ratio=ratio).tolist()
    np.testing.assert_allclose(scores[matched], np.sum(a.descriptors[matched] * b.descriptors[partners[matched]], 1))
    assert (scores[partners == -1] == 0).all()


def test_the_page_on_pipelines_lets_photographs_share_their_camera() -> None:
    page = (ROOT / "docs" / "pipelines.md").read_text(encoding="utf-8")
    command = page.split("colmap feature_importer", 1)[1].split("colmap matches_importer")[0]
    assert "--ImageReader.single_camera 1" in command
    assert "camera_mode=pycolmap.CameraMode.SINGLE" in page.split("reconstruction.main(", 1)[1].split("```")[0]


@pytest.mark.parametrize(("words", "status"), [(["--help"], 0), ([], 2), (["none.jpg", "view.png"], 1)])
def test_the_demo_s_script_explains_itself(words: list[str], status: int, tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "demo" / "second_view.py"), *words]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == status
    assert "Traceback" not in ended.stderr
