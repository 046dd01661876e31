"""elf-bench's peers: OpenCV's detectors, and PyTorch where it can be held against the model."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from elf_runtime.commands.bench import main
from elf_runtime.commands.bench_workloads import PEER_KEYPOINTS, _opencv, float_model, peers, synthetic, torch_peer
from elf_runtime.model import bundled_model
from elf_runtime.model.ort_format import to_ort
from helpers import TINY


def test_torch_needs_the_onnx_file_of_a_model_in_ort_format(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = to_ort(TINY, tmp_path / "tiny.ort")
    quick = ["--repeats", "1", "--warmup", "1", "--processes", "1", "--threads", "1", "--sizes", "64x64"]
    assert main([*quick, "--model", str(model), "--peers", "torch"]) == 2
    error = capsys.readouterr().err
    assert f"--peers torch: {model} is in ORT format; give the .onnx file" in error
    assert "as --torch-model" in error


@pytest.mark.parametrize("name", ["sift", "orb"])
def test_a_peer_finds_at_most_so_many(name: str) -> None:
    (peer,) = peers([name], synthetic(480, 640), None)
    count, stages = peer.run()
    assert 0 < count <= PEER_KEYPOINTS + 1  # SIFT may keep one more, at the same place
    assert stages == {}


def test_a_peer_s_time_has_its_descriptors() -> None:
    class Detector:
        def detectAndCompute(self, image: object, mask: object) -> tuple[list[int], None]:  # noqa: N802
            assert (image, mask) == ("grey", None)
            return [1, 2, 3], None

    assert _opencv(Detector(), "grey")() == (3, {})


def test_whose_weights_torch_takes() -> None:
    assert float_model("a.onnx", "b.onnx") == "b.onnx"
    assert float_model("a.onnx", None) == "a.onnx"
    assert float_model(None, None) == str(bundled_model("fp32"))


def test_torch_is_left_out_with_a_reason() -> None:
    # Either it is not installed, or the tiny model's network is none that can be rebuilt.
    saliency, reason = torch_peer(str(TINY), 1)
    assert saliency is None
    assert "not installed" in reason or "tiny" in reason


@pytest.mark.torch
def test_torch_is_held_against_the_float_twin_of_the_bundled_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    quick = ["--repeats", "1", "--warmup", "1", "--processes", "1", "--threads", "1", "--sizes", "64x96"]
    assert main([*quick, "--peers", "torch", "--json", str(tmp_path / "b.json")]) == 0
    (entry,) = json.loads((tmp_path / "b.json").read_text())["sizes"]
    sides = [("elf_saliency", "elf_saliency_twin"), ("elf_saliency_twin", "torch"), ("elf_saliency", "torch")]
    assert set(entry["ratios"]) == {f"{a} / {b}" for a, b in sides}
    assert entry["saliency_agreement"]["precision"] == "fp32"
    assert entry["saliency_agreement"]["share"] > 0.99
    text = capsys.readouterr().out
    assert "ELF saliency alone, int8 / torch autograd, the saliency in fp32: " in text
    assert "ELF saliency alone, fp32 / torch autograd, the saliency in fp32: " in text
