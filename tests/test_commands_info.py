"""elf-info: what it says of a model, of a foreign one, and of what is none."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import onnxruntime as ort
import pytest

from elf_runtime import ElfRuntime, ModelContract
from elf_runtime.commands._info_text import _parity_rows
from elf_runtime.commands.info import gflop_per_megapixel, main
from elf_runtime.coverage import from_events, measure
from elf_runtime.onnx_file import read_onnx
from elf_runtime.session import bundled_model
from helpers import textured

TINY = Path(__file__).parent / "data" / "tiny.onnx"


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


def test_measured_errors_and_scores_are_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(bundled_model("int8")), "--provider", "cpu"]) == 0
    text = capsys.readouterr().out
    contract = ElfRuntime().contract
    for key, words in (
        ("median_error", "  parity           median error of the saliency against float64, of its maximum"),
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
def test_what_is_no_model_is_one_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes
) -> None:
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
