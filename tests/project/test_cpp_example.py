"""The C++ example finds what Python's ONNX Runtime finds with the same file: the same library runs under both.

ONNX Runtime's C++ headers come from $ELF_ORT, which names a folder with its include, or from the system.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import onnxruntime as ort
import pytest

from elf_runtime import match
from elf_runtime.model import bundled_model
from helpers import ROOT
from project.cpp_program import Rows, compiled, end_to_end_model, printed, run
from project.example_inputs import EXAMPLES


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("cpp"))


@pytest.fixture(scope="module", params=["uint8", "float32"])
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return end_to_end_model(tmp_path_factory.mktemp("model") / "model.onnx", pixels=request.param)


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A photograph and its turned and darkened middle, without loss: decoders of JPEG may differ in a pixel."""
    folder = tmp_path_factory.mktemp("views")
    image = cv2.imread(str(ROOT / "demo" / "palace.jpg"))
    turned = cv2.warpAffine(image, cv2.getRotationMatrix2D((320, 213), 8, 1.1), (560, 400), flags=cv2.INTER_AREA)
    for name, view in (("first", image), ("second", turned // 2)):
        cv2.imwrite(str(folder / f"{name}.png"), view)
    return folder / "first.png", folder / "second.png"


def found_by_python(model: Path, image: Path, **inputs: npt.ArrayLike) -> tuple[Rows, Rows, Rows]:
    options = ort.SessionOptions()
    options.log_severity_level = 3
    session = ort.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
    kind = np.float32 if session.get_inputs()[0].type == "tensor(float)" else np.uint8
    keypoints, scores, descriptors = session.run(None, {"image": cv2.imread(str(image))[None].astype(kind), **inputs})
    return keypoints, scores, descriptors


def test_the_keypoints_are_python_s(program: Path, model: Path, views: tuple[Path, Path]) -> None:
    keypoints, scores, _ = found_by_python(model, views[0])
    assert len(keypoints) == 500
    np.testing.assert_array_equal(printed(program, model, views[0]), np.column_stack([keypoints, scores]))


def test_the_optional_inputs_arrive(program: Path, model: Path, views: tuple[Path, Path], tmp_path: Path) -> None:
    mask = np.zeros(cv2.imread(str(views[0])).shape[:2], np.uint8)
    mask[100:300, 150:500] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    words = {
        ("--max-keypoints", "7"): {"max_keypoints": np.array(7, np.int64)},
        ("--threshold", "0.6"): {"threshold": np.array(0.6, np.float32)},
        ("--mask", str(tmp_path / "mask.png")): {"mask": mask},
    }
    everywhere = len(printed(program, model, views[0]))
    for option, given in words.items():
        keypoints, scores, _ = found_by_python(model, views[0], **given)
        assert len(keypoints) > 0
        assert len(keypoints) < everywhere or (keypoints[:, 0] >= 149.5).all()
        np.testing.assert_array_equal(printed(program, *option, model, views[0]), np.column_stack([keypoints, scores]))


def test_the_matches_are_python_s_and_are_drawn(
    program: Path, model: Path, views: tuple[Path, Path], tmp_path: Path
) -> None:
    first, second = (found_by_python(model, view) for view in views)
    for ratio, words in ((0.9, ()), (0.8, ("--ratio", "0.8")), (None, ("--ratio", "1"))):
        rows = printed(program, *words, model, *views, tmp_path / "drawn.png")
        pairs = match(first[2], second[2], ratio)
        assert len(pairs) > 100
        np.testing.assert_array_equal(rows, np.hstack([first[0][pairs[:, 0]], second[0][pairs[:, 1]]]))
    drawn, (one, two) = cv2.imread(str(tmp_path / "drawn.png")), (cv2.imread(str(view)) for view in views)
    assert drawn.shape == (max(one.shape[0], two.shape[0]), one.shape[1] + two.shape[1], 3)
    assert (drawn[: one.shape[0], : one.shape[1]] == one).all(axis=2).mean() > 0.2  # the picture, and lines over it
    assert not (drawn[: one.shape[0], : one.shape[1]] == one).all()


def test_no_keypoints_make_no_matches(program: Path, model: Path, views: tuple[Path, Path], tmp_path: Path) -> None:
    assert printed(program, "--max-keypoints", "0", model, *views, tmp_path / "drawn.png").size == 0
    assert cv2.imread(str(tmp_path / "drawn.png")) is not None


def test_what_is_wrong_is_said_in_one_line(program: Path, views: tuple[Path, Path], tmp_path: Path) -> None:
    from elf_export.cli import main as export

    model, batch = end_to_end_model(tmp_path / "a.onnx"), end_to_end_model(tmp_path / "b.onnx", batch=True)
    required, rgb = end_to_end_model(tmp_path / "required.onnx", required=True), tmp_path / "rgb.onnx"
    assert export(["--elf", "int8", "--end-to-end", "rgb", "--quiet", "-o", str(rgb)]) == 0
    (tmp_path / "text.onnx").write_text("text")
    cv2.imwrite(str(tmp_path / "small.png"), np.ones((9, 9), np.uint8))
    picture, folder = views[0], tmp_path
    wrong: list[tuple[list[str | Path], str]] = [
        ([folder / "absent.onnx", picture], "absent.onnx"),
        ([folder / "text.onnx", picture], "text.onnx"),
        ([bundled_model(), picture], "not an end-to-end model (elf-export --end-to-end makes them)"),
        ([batch, picture], "made for batches"),
        ([required, picture], "made with 'required'"),
        ([rgb, picture], "made for R G B"),
        ([model, folder / "absent.png"], "absent.png: not there, or no image"),
        ([model, folder / "text.onnx"], "text.onnx: not there, or no image"),
        ([model, picture, picture, folder / "absent" / "drawn.png"], "drawn.png"),
        ([model, picture, picture, folder / "drawn.xyz"], "drawn.xyz"),
        (["--max-keypoints", "-1", model, picture], "max_keypoints is 0 or more"),
        (["--threshold", "much", model, picture], "--threshold: 'much' is no number"),
        (["--threshold", "nan", model, picture], "threshold is a number"),
        (["--mask", folder / "small.png", model, picture], "a mask has 8 bits, one channel and the size of the image"),
        (["--ratio", "0", model, picture, picture, folder / "drawn.png"], "ratio is a number above 0, at most 1"),
    ]
    for words, reason in wrong:
        done = run(program, *words)
        assert done.returncode == 1
        assert done.stderr.startswith("elf: ")
        assert reason in done.stderr
        assert done.stderr.count("\n") == 1, done.stderr
    for usage in ([], [model], [model, picture, picture], ["--help"], [model, picture, "--mask"]):
        assert run(program, *usage).returncode == 2


def test_the_example_is_short() -> None:
    assert len((EXAMPLES / "cpp" / "elf.hpp").read_text(encoding="utf-8").splitlines()) < 200
