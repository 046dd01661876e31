"""The examples in other languages give what Python's ONNX Runtime gives, where their tools are installed.

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

from elf_runtime.model import bundled_model
from elf_runtime.model.session import open_session
from helpers import ROOT
from project.example_inputs import EXAMPLES, PICTURE


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


@pytest.mark.parametrize(("words", "status"), [(["--help"], 0), ([], 2), (["none.jpg", "view.png"], 1)])
def test_the_demo_s_script_explains_itself(words: list[str], status: int, tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "demo" / "second_view.py"), *words]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == status
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("line", ["ElfFeature2D(max_keypoints=500)", "cv2.SIFT_create(500)"])
def test_a_tracker_takes_elf_for_sift(line: str, tmp_path: Path) -> None:
    """The view moves by 4 and 3 pixels a frame; the script finds that with either detector."""
    picture = cv2.imread(str(ROOT / "demo" / "palace.jpg"))
    for frame in range(3):
        cv2.imwrite(
            str(tmp_path / f"frame{frame:03d}.png"), picture[3 * frame : 300 + 3 * frame, 4 * frame : 400 + 4 * frame]
        )
    script = (EXAMPLES / "opencv" / "track.py").read_text(encoding="utf-8")
    assert script.count("ElfFeature2D(max_keypoints=500)") == 1
    (tmp_path / "track.py").write_text(script.replace("ElfFeature2D(max_keypoints=500)", line), encoding="utf-8")
    done = run(sys.executable, "track.py", "frame%03d.png", "out", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    rows = re.findall(r"^frame (\d): .* (\d+) inliers, centre at ([\d.]+) ([\d.]+)$", done.stdout, re.MULTILINE)
    assert [int(number) for number, *_ in rows] == [0, 1, 2]
    for number, inliers, x, y in rows:
        assert int(inliers) > 50
        assert (float(x), float(y)) == pytest.approx((200 + 4 * int(number), 150 + 3 * int(number)), abs=0.5)
    assert len(list((tmp_path / "out").iterdir())) == 3
