"""The example for Node: an end-to-end file gives Python's keypoints, and the matching's file its matches.

Its packages are looked for in examples/node/node_modules; ``$ELF_NODE_MODULES`` may name another folder.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import onnxruntime as ort
import pytest

from elf_runtime import ElfRuntime
from elf_runtime.model import bundled_model
from helpers import ROOT

NODE = ROOT / "examples" / "node"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example with its packages, two models and two pictures beside it."""
    onnx = pytest.importorskip("onnx")
    modules = Path(os.environ.get("ELF_NODE_MODULES", NODE / "node_modules"))
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    if not (modules / "onnxruntime-node").is_dir() or not (modules / "sharp").is_dir():
        pytest.skip("npm's onnxruntime-node and sharp are not installed (npm install in examples/node)")
    from elf_export.cli import main
    from elf_export.end_to_end.build import Form, end_to_end
    from elf_export.file import stamped

    folder = tmp_path_factory.mktemp("node")
    for name in ("keypoints.mjs", "package.json"):
        shutil.copy(NODE / name, folder)
    (folder / "node_modules").symlink_to(modules.resolve(), target_is_directory=True)
    contract = ElfRuntime(bundled_model("fp32")).contract
    for name, form in (("alone.onnx", Form()), ("floats.onnx", Form("float32")), ("batch.onnx", Form(batch=True))):
        whole = end_to_end(onnx.load(bundled_model("fp32")), contract, form)
        (folder / name).write_bytes(stamped(whole, replace(contract, end_to_end=form.spec)))
    assert main(["--match", "-o", str(folder / "match.onnx"), "--quiet"]) == 0
    picture = cv2.imread(str(ROOT / "demo" / "palace.jpg"))[100:340, 150:470]
    cv2.imwrite(str(folder / "first.png"), picture)
    cv2.imwrite(str(folder / "second.png"), picture[20:, 30:])
    cv2.imwrite(str(folder / "grey.png"), cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
    return folder


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["node", "keypoints.mjs", *words], cwd=folder, capture_output=True, text=True, check=False, timeout=300
    )


def numbers(folder: Path, *words: str) -> npt.NDArray[np.float64]:
    done = run(folder, *words)
    assert (done.returncode, done.stderr) == (0, "")
    return np.array([line.split() for line in done.stdout.splitlines()], float)


def session(path: Path) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.log_severity_level = 3
    return ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])


@pytest.mark.parametrize(
    ("model", "picture"), [("alone.onnx", "first.png"), ("floats.onnx", "first.png"), ("alone.onnx", "grey.png")]
)
def test_it_finds_python_s_keypoints(folder: Path, model: str, picture: str) -> None:
    rows = numbers(folder, model, picture)
    keypoints, scores, _ = session(folder / "alone.onnx").run(None, {"image": cv2.imread(str(folder / picture))[None]})
    assert len(rows) == len(keypoints) > 100
    assert np.mean(np.abs(rows[:, :2] - keypoints).max(axis=1) < 0.01) > 0.99
    np.testing.assert_allclose(rows[:, 2], scores, rtol=1e-2)


def test_it_matches_as_python_does(folder: Path) -> None:
    rows = numbers(folder, "alone.onnx", "first.png", "second.png", "match.onnx")
    alone = session(folder / "alone.onnx")
    (a, _, da), (b, _, db) = (
        alone.run(None, {"image": cv2.imread(str(folder / name))[None]}) for name in ("first.png", "second.png")
    )
    matches = session(folder / "match.onnx").run(["matches"], {"descriptors_a": da, "descriptors_b": db})[0]
    assert len(matches) > 80
    wanted = {tuple(np.rint(row)) for row in np.hstack([a[matches[:, 0]], b[matches[:, 1]]])}
    assert len(wanted & {tuple(np.rint(row)) for row in rows}) > 0.98 * max(len(matches), len(rows))
    assert np.mean(np.abs(rows[:, :2] - rows[:, 2:] - [30, 20]).max(axis=1) < 2) > 0.9


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        ([], 2, "usage: node keypoints.mjs"),
        (["alone.onnx", "first.png", "second.png"], 2, "usage: node keypoints.mjs"),
        (["absent.onnx", "first.png"], 1, "absent.onnx"),
        (["alone.onnx", "absent.png"], 1, "absent.png"),
        (["match.onnx", "first.png"], 1, "match.onnx: not an end-to-end model"),
        (["batch.onnx", "first.png"], 1, "batch.onnx: not an end-to-end model for one image"),
    ],
)
def test_what_goes_wrong_is_said_in_a_line(folder: Path, words: list[str], status: int, told: str) -> None:
    done = run(folder, *words)
    assert (done.returncode, done.stdout) == (status, "")
    assert told in done.stderr
    assert "    at " not in done.stderr
