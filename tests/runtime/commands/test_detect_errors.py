"""elf-detect: what it says, and the status it ends with, when it can't."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import onnxruntime as ort
import pytest

from elf_runtime import Features
from elf_runtime.commands.detect import main
from helpers import TINY, textured
from runtime.commands.detecting import detect, write

MISSING = next(name for name in ort.get_all_providers() if name not in ort.get_available_providers())


def test_a_bad_image_among_good_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, other = write(tmp_path / "good.png"), write(tmp_path / "other.png", 1)
    bad, absent = tmp_path / "bad.png", tmp_path / "absent.png"
    bad.write_text("no image")
    out, summary = tmp_path / "out", tmp_path / "summary.json"
    assert detect(good, bad, absent, other, "-o", out, "--json", summary) == 1
    assert {p.name for p in out.glob("*.npz")} == {"good.npz", "other.npz"}
    assert not list(out.glob("bad*")) + list(out.glob("absent*"))
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 2
    assert all(line.startswith("elf-detect: error: ") for line in errors)
    assert str(bad) in errors[0]
    assert str(absent) in errors[1]
    images = json.loads(summary.read_text())["images"]
    assert ["error" in entry for entry in images] == [False, True, True, False]
    assert [entry["error"] for entry in images[1:3]] == [line.partition("error: ")[2] for line in errors]
    assert images[0]["keypoints"] == len(Features.load(out / "good.npz"))


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        (["--threshold", "2"], 2, "threshold"),
        (["--nms-radius", "-1"], 2, "nms_radius"),
        (["--scale", "0"], 2, "scale"),
        (["--descriptor", "pool9"], 2, "no descriptor layer 'pool9'"),
        (["--provider", MISSING], 1, "Install the build that has it, or take one of these"),
        (["--provider", "quantum"], 1, "unknown provider 'quantum'"),
        (["--mask", "absent.png"], 1, "absent.png"),
        (["--set", "sale=1"], 2, "--set: unknown setting 'sale'; known are denoise, threshold_blur, threshold, nms_"),
        (["--set", "mask=1"], 2, "--set: unknown setting 'mask'"),
        (["--set", "preset=fast"], 2, "--set: unknown setting 'preset'"),
        (["--set", "scale=0.5", "--scale", "0.4"], 2, "--set scale: --scale is given too"),
        (["--set", "normalize=2"], 2, "normalize is a quantile in (0, 1], not 2"),
        (["--set", "subpixel=maybe"], 2, "subpixel is True or False, not 'maybe'"),
    ],
)
def test_one_line_for_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], status: int, reason: str
) -> None:
    assert detect(write(tmp_path / "a.png"), "-o", tmp_path / "out", *arguments) == status
    error = capsys.readouterr().err
    assert error.startswith("elf-detect: error: ")
    assert error.count("\n") == 1
    assert reason in error


@pytest.mark.parametrize("content", [b"", b"text", TINY.read_bytes()[:6000]])
def test_a_file_that_is_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes) -> None:
    model = tmp_path / "model.onnx"
    model.write_bytes(content)
    image = write(tmp_path / "a.png")
    assert main([str(image), "-o", str(tmp_path / "out"), "--model", str(model)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert str(model) in error
    assert not (tmp_path / "out").exists()


def test_an_interruption_has_the_shell_s_status(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("elf_runtime.commands.detect.image_files", interrupted)
    assert detect("a.png", "-o", tmp_path) == 130


@pytest.mark.parametrize("text", ["ax6", "2,3", "0x3", "4x", "4x6x2"])
def test_a_grid_that_is_none_is_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["a.png", "-o", "out", "--grid", text])
    assert capsys.readouterr().err.endswith(f"argument --grid: {text!r} is not ROWSxCOLUMNS\n")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--threshold", "1,2"], "threshold is 'kapur', 'none' or a number in [0, 1], not 1,2"),
        (["--set", "grid=4,0"], "grid is (rows, columns), integers >= 1, not 4,0"),
        (["--set", "denoise=4,1.5"], "denoise is (mu, sigma) with mu odd, 1 to 999, and sigma > 0, not 4,1.5"),
    ],
)
def test_a_setting_s_error_shows_what_was_typed(
    words: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(48, 64))
    assert main([str(tmp_path / "a.png"), "-o", str(tmp_path / "out"), "--model", str(TINY), *words]) == 2
    assert capsys.readouterr().err == f"elf-detect: error: {reason}\n"
