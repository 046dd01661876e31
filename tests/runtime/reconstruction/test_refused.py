"""What elf-reconstruct and elf-localize refuse, each in one line, before any work; and nothing is left half-written."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime, Features, SettingError
from elf_runtime.commands import localize, reconstruct
from elf_runtime.files.write import new_folder
from elf_runtime.reconstruction import Model, read_model
from elf_runtime.reconstruction import localize as place
from helpers import TINY, textured

needs_pycolmap = pytest.mark.skipif(
    importlib.util.find_spec("pycolmap") is None, reason="pycolmap, of the extra sfm, is not installed"
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    for name in ("a", "b"):
        cv2.imwrite(str(tmp_path / "photos" / f"{name}.png"), textured(64, 96, seed=ord(name)))
    return tmp_path


def failed(command: Any, capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    """Exit status and error."""
    status = command.main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    errors = [line for line in captured.err.splitlines() if "error: " in line]
    assert len(errors) == 1, captured.err
    return status, errors[0].partition("error: ")[2]


def test_without_pycolmap_the_extra_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    status, text = failed(reconstruct, capsys, folder / "photos", "-o", folder / "out")
    assert (status, text.endswith('pip install "elf-onnx[sfm]"')) == (1, True)
    assert text.startswith("reconstruction needs pycolmap, which ")
    assert sorted(path.name for path in folder.iterdir()) == ["photos"]


def test_an_older_pycolmap_is_said_to_be_too_old(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", SimpleNamespace(__version__="3.13.0"))
    status, text = failed(reconstruct, capsys, folder / "photos", "-o", folder / "out")
    assert status == 1
    assert text.startswith("reconstruction needs pycolmap 4.0 or later, and this is 3.13.0: pip install")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--refine-intrinsics",), "--refine-intrinsics needs --K or --camera"),
        (("--pairs", "nearest"), "--pairs nearest: not exhaustive, sequential, sequential:N or nearest:N"),
        (("-o", "photos"), "neither within"),
        (("-o", "photos/out"), "neither within"),
        (("-o", "."), "nor around it"),
        (("-o", "there"), "it exists; --overwrite replaces it"),
        (("-o", "there", "--overwrite"), "has no reconstruction.json, so elf-reconstruct did not write it"),
    ],
)
def test_a_command_line_that_can_t_be_carried_out(
    options: tuple[str, ...], expected: str, folder: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(folder)
    (folder / "there").mkdir()
    status, text = failed(reconstruct, capsys, "photos", "-o", "out", *options)
    assert status == 2
    assert expected in text


def test_a_folder_that_is_not_there_or_has_one_image(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, text = failed(reconstruct, capsys, folder / "none", "-o", folder / "out")
    assert (status, "there is no such folder" in text) == (2, True)
    (folder / "photos" / "b.png").unlink()
    status, text = failed(reconstruct, capsys, folder / "photos", "-o", folder / "out")
    assert (status, "needs two images" in text) == (2, True)


@pytest.mark.skipif(sys.platform != "linux", reason="this system's names are Unicode")
def test_a_name_that_is_not_unicode(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path(os.fsdecode(os.fsencode(folder / "photos") + b"/\xff.png")).write_bytes(b"")
    status, text = failed(reconstruct, capsys, folder / "photos", "-o", folder / "out")
    assert (status, "names in Unicode only" in text) == (2, True)


@pytest.mark.parametrize(
    ("option", "value"),
    [("--ratio", "1"), ("--ratio", "x")],
)
def test_values_of_options(option: str, value: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        reconstruct.main([str(folder / "photos"), "-o", str(folder / "out"), option, value])
    assert stopped.value.code == 2
    assert repr(value) in capsys.readouterr().err


@needs_pycolmap
def test_images_that_have_nothing_in_common_leave_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, text = failed(
        reconstruct, capsys, folder / "photos", "-o", folder / "out", "--model", TINY, "--preset", "default"
    )
    assert (status, text.startswith("no two images could be placed")) == (1, True)
    assert sorted(path.name for path in folder.iterdir()) == ["photos"]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("--K=1,2,3", "--K 1,2,3: a camera is fx,fy,cx,cy in pixels, one focal length, or a file"),
        ("--K=0,1,1,1", "--K 0,1,1,1: a camera is"),
        ("--K=", "--K : not fx,fy,cx,cy, not one focal length, and no file"),
        ("--K=skew.txt", "--K skew.txt: COLMAP's cameras have no skew, and this one's is 0.5"),
        ("--camera=PINHOLE", "'PINHOLE' is not MODEL:p1,p2,..."),
    ],
)
def test_what_is_no_camera(
    given: str, expected: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    Path("skew.txt").write_text("80 0.5 48\n0 80 32\n0 0 1\n")
    for command, words in ((reconstruct, ("photos", "-o", "out")), (localize, ("scene", "photos/a.png"))):
        status, text = failed(command, capsys, *words, given)
        assert (status, text.startswith(expected)) == (2, True), text


@needs_pycolmap
@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("--camera=FISHY:1,2", "camera FISHY:1,2: COLMAP's models are SIMPLE_PINHOLE, "),
        ("--camera=PINHOL:80,80,48,32", "; did you mean 'PINHOLE'?"),
        ("--camera=OPENCV:80,80,48,32", "camera OPENCV:80,80,48,32: the parameters of OPENCV are fx, fy, cx, cy, k1"),
        ("--camera=PINHOLE:80,80,960,32", "this can't be the camera of images of 96x64 pixels"),
        ("--K=80,80,100,32", "this can't be the camera of images of 96x64 pixels"),
        ("--K=80,80,1e9,1e9", "--K: the principal point 1e+09,1e+09 lies far outside an image of 96x64 pixels"),
    ],
)
def test_a_camera_that_colmap_does_not_take_is_refused_before_any_work(
    given: str, expected: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(ElfRuntime, "detect", None)  # no image gets that far
    status, text = failed(reconstruct, capsys, folder / "photos", "-o", folder / "out", "--model", TINY, given)
    assert (status, expected in text) == (2, True), text


def test_what_is_no_scene_can_t_be_localised_in(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = folder / "photos" / "a.png"
    status, text = failed(localize, capsys, folder, image)
    assert (status, "not a folder that elf-reconstruct wrote" in text) == (1, True)
    (folder / "reconstruction.json").write_text("{}")
    assert "not a folder that elf-reconstruct wrote" in failed(localize, capsys, folder, image)[1]


@pytest.mark.parametrize(
    ("given", "expected"), [("b", "a, an image of the model"), ("", "a and 1 more of the model's images")]
)
def test_features_of_the_model_s_images_that_are_not_given_are_named(given: str, expected: str) -> None:
    rows = np.ones((3, 8), np.float32)
    one = Features(np.zeros((3, 2), np.float32), np.ones(3, np.float32), rows, (64, 96))
    tracks = {name: np.full(3, -1) for name in "ab"}
    model = Model({}, {}, np.zeros((0, 3)), np.zeros((0, 3), np.uint8), tracks, 0.0, 0.0)
    with pytest.raises(SettingError, match=f"^there are no features of {expected}$"):
        place(model, dict.fromkeys(given, one), one)


def test_a_folder_without_a_model_is_said_to_be_one(tmp_path: Path) -> None:
    with pytest.raises(Exception, match=r"no model of COLMAP's in this folder"):
        read_model(tmp_path)


def test_a_new_folder_replaces_the_old_one_only_when_it_is_whole(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    with new_folder(out) as part:
        (part / "1").write_text("first")
        assert not out.exists()
    with pytest.raises(KeyboardInterrupt), new_folder(out) as part:
        interrupted(part / "2")
    assert [path.name for path in out.iterdir()] == ["1"]
    with new_folder(out) as part:
        (part / "3").write_text("third")
    assert [path.name for path in out.iterdir()] == ["3"]
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def interrupted(path: Path) -> None:
    path.write_text("second")
    raise KeyboardInterrupt


def test_a_model_says_what_it_is() -> None:
    model = Model({}, {}, np.zeros((0, 3)), np.zeros((0, 3), np.uint8), {}, 0.0, 0.0)
    assert repr(model) == "Model(0 images, 0 points)"
