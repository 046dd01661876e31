"""elf-info: what it says of a model, of a foreign one, and of what is none."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import onnxruntime as ort
import pytest

from elf_runtime import ElfRuntime, ModelContract
from elf_runtime.commands.info import gflop_per_megapixel, main
from elf_runtime.commands.info_text import _agreement, _coverage, _descriptor, _parity_rows, _sizes
from elf_runtime.model import bundled_model
from elf_runtime.model.coverage import from_events, measure
from elf_runtime.model.onnx_file import read_onnx
from helpers import ROOT, TINY, textured


def contract() -> ModelContract:
    return ModelContract.from_metadata(read_onnx(TINY).metadata, str(TINY))


def without_contract(path: Path) -> Path:
    """The tiny model under other metadata keys, of the same lengths."""
    path.write_bytes(TINY.read_bytes().replace(b"elf.", b"alf."))
    return path


def test_says_what_the_model_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(TINY)]) == 0
    text = capsys.readouterr().out
    for expected in (
        "tiny pool1",
        "relu2: 8 values",
        "MaxPool 1",
        "GFLOP per megapixel",
        "random, seed",
        "808",
    ):
        assert expected in text
    assert "CPU              runs every op" in text
    assert "not installed here, tried with the bundled models" in text
    assert "TensorRT" not in text.partition("not installed here")[0]
    assert "cv2.dnn          int8's maps" in text


def test_measured_errors_and_scores_are_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(bundled_model("int8")), "--provider", "cpu"]) == 0
    text = capsys.readouterr().out
    contract = ElfRuntime().contract
    for key, words in (
        (
            "derivative_median_error",
            "  parity           median error of derivatives against central differences, relative",
        ),
        ("lower_ms", "matching score between images and views of them in int8, %"),
        ("lower_ms_fp32", "matching score between images and views of them in fp32, %"),
    ):
        assert f"{words}: {contract.parity[key]:.4g}" in text
    for key in contract.parity:
        assert key not in text
    rows = _parity_rows({"new_figure": 0.25, "max_error": 1e-3}, "int8")
    assert rows == [
        "  parity           largest error of the saliency, of its maximum: 0.001",
        "                   new_figure: 0.25",
    ]
    for key in ("alone_near", "alone_counts", "alone_cosine"):  # of end-to-end files
        assert key not in _parity_rows({key: 1.0}, "int8")[0]


def test_what_the_report_says_in_words() -> None:
    found = {"reference": 8, "found": 9, "same": 0.25, "near": 0.5, "cosine": 0.75, "least_cosine": 0.125}
    text = "9 keypoints, the CPU 8; 25.0% the same within 0.5 px, 50.0% within 1 px"
    text += "; cosine of their descriptors 0.75000, at least 0.12500"
    assert _agreement({**found, "sufficient": True}) == text
    assert _agreement({**found, "sufficient": False}) == f"DIFFERS: {text}"

    free = {"height": 0, "width": 0, "min_size": 32, "multiple": 1}
    assert _sizes(free) == "at least 32x32"
    assert _sizes({**free, "multiple": 8}) == "at least 32x32, resized to multiples of 8"
    assert _sizes({**free, "height": 60, "width": 80}) == "resized to 80x60 (width x height)"

    reduction = {"method": "pca", "source_dim": 256, "whiten": 0.5, "kept": 0.9, "calibration": "c", "sha256": "ab"}
    spec = {"layer": "pool4", "dim": 64, "stride": 8.0, "reduction": reduction}
    assert "of 256 channels by pca, whitened by 0.5, 90% of their variance" in _descriptor(spec)
    assert "by pca, 90%" in _descriptor({**spec, "reduction": {**reduction, "whiten": 0.0}})

    run = {"error": "", "complete": False, "ran": {"Conv": 2}, "elsewhere": {"CPU": {"Sign": 1}}}
    assert _coverage(run) == "runs Conv 2; CPU runs Sign 1"
    assert _coverage({**run, "complete": True, "elsewhere": {}}) == "runs every op (2 executed nodes)"
    assert _coverage({**run, "ran": {}}) == "runs no op; all is left to CPU"
    assert _coverage({**run, "error": "no device"}) == "can't run it: no device"


def test_no_file_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo = tmp_path / "photo.ort"  # decoded by its content
    photo.write_bytes(cv2.imencode(".png", textured(64, 80))[1].tobytes())
    before = photo.read_bytes()
    assert main([str(TINY), "--image", str(photo), "--ort", str(photo)]) == 2
    assert "--ort: " in capsys.readouterr().err
    assert main([str(TINY), "--ort", str(tmp_path / "absent" / "a.ort")]) == 1
    captured = capsys.readouterr()
    assert "--ort: there is no folder" in captured.err
    assert captured.out == ""
    assert photo.read_bytes() == before


@pytest.mark.parametrize("asked", [[], ["--provider", "cpu"]])
def test_an_image_that_can_t_be_used_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], asked: list[str]
) -> None:
    photo = tmp_path / "small.png"
    cv2.imwrite(str(photo), textured(9, 11))
    assert main([str(TINY), "--image", str(photo), *asked]) == 1
    captured = capsys.readouterr()
    assert captured.err.startswith(f"elf-info: error: {photo}: the image has 11x9 pixels; the smallest is ")
    assert captured.err.count("\n") == 1
    assert "can't run it" not in captured.out


def test_json_holds_the_whole_contract(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(TINY), "--json", "--provider", "cpu"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["contract"]["network"] == "tiny"
    assert report["graph"]["ops"]["MaxPool"] == 1
    assert report["graph"]["inputs"]["image"]["dims"] == ["N", "H", "W", 3]
    assert list(report["providers"]) == ["CPUExecutionProvider"]
    assert report["providers"]["CPUExecutionProvider"]["complete"] is True
    assert report["graph"]["stored"]["float32"]["values"] >= 808


def test_a_multiply_add_is_two_operations() -> None:
    # Multiply-adds a pixel: 9 * 3 * 8 = 216 in conv1 and in its adjoint, 9 * 8 * 8 / 4 = 144 in conv2.
    found = gflop_per_megapixel(contract())
    assert found["saliency"] == pytest.approx(2 * 432 * 1e6 / 1e9)
    assert found["all outputs"] == pytest.approx(2 * 576 * 1e6 / 1e9)


def test_the_cpu_runs_everything() -> None:
    found = measure(TINY, contract(), "CPUExecutionProvider")
    assert found.complete
    assert found.ran["MaxPool"] == 1


@pytest.mark.skipif("AzureExecutionProvider" not in ort.get_available_providers(), reason="not in this build")
def test_a_provider_that_takes_no_node_is_found_out() -> None:
    # Azure's provider is installed with the CPU build and runs none of ONNX's own ops.
    found = measure(TINY, contract(), "AzureExecutionProvider")
    assert not found.complete
    assert found.ran == {}
    assert "Conv" in found.elsewhere["CPUExecutionProvider"]


@pytest.mark.parametrize(("asked", "status"), [([], 0), (["--provider", "cpu"], 1)])
def test_only_the_provider_asked_for_fails_the_command(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, asked: list[str], status: int
) -> None:
    """And then nothing is converted."""

    def measured(*_: object) -> dict[str, object]:
        run = {"provider": "CPUExecutionProvider", "ran": {}, "elsewhere": {}, "complete": False, "agreement": None}
        return run | {"error": "no such device"}

    monkeypatch.setattr("elf_runtime.commands.info._measured", measured)
    assert main([str(TINY), *asked, "--ort", str(tmp_path / "m.ort")]) == status
    assert (tmp_path / "m.ort").exists() == (status == 0)


def test_a_profile_is_split_by_provider() -> None:
    def event(op: str, provider: str, kind: str = "kernel_time") -> dict[str, object]:
        return {"cat": "Node", "name": f"n_{kind}", "args": {"op_name": op, "provider": provider}}

    events = [
        event("Conv", "X"),
        event("Conv", "X"),
        event("Sign", "CPU"),
        event("Conv", "X", "fence_before"),
    ]
    found = from_events("X", [*events, {"cat": "Session", "name": "model_run"}])
    assert found.ran == {"Conv": 2}
    assert found.elsewhere == {"CPU": {"Sign": 1}}
    assert not found.complete


def test_a_foreign_model_is_shown_and_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(without_contract(tmp_path / "other.onnx"))]) == 1
    captured = capsys.readouterr()
    assert "MaxPool 1" in captured.out
    assert "saliency  float32 (N, H, W)" in captured.out
    assert captured.err.startswith("elf-info: error: ")
    assert "not an ELF model" in captured.err
    assert captured.err.count("\n") == 1


@pytest.mark.parametrize("content", [b"", b"plain text\n", TINY.read_bytes()[:7000]])
def test_what_is_no_model_is_one_error(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes) -> None:
    file = tmp_path / "x.onnx"
    file.write_bytes(content)
    assert main([str(file)]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"elf-info: error: {file}: ")
    assert captured.err.count("\n") == 1


def test_a_missing_file_and_an_unknown_provider(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["absent.onnx"]) == 1
    assert "absent.onnx: No such file" in capsys.readouterr().err
    assert main([str(TINY), "--provider", "quantum"]) == 1
    assert "unknown provider 'quantum'" in capsys.readouterr().err


def test_a_reader_that_has_seen_enough_ends_the_command_quietly() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
    env.pop("PYTHONUNBUFFERED", None)  # with it, nothing is left to be flushed at exit
    command = [sys.executable, "-m", "elf_runtime.commands.info", str(TINY), "--provider", "cpu"]
    ended = subprocess.run(command, env=env, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (ended.returncode, ended.stderr) == (1, "")
