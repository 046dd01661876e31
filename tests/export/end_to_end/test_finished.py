"""elf-export --elf: what follows the network, put into a model that is there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime as ort
import pytest

from elf_export.cli import main
from elf_runtime import ElfRuntime, ModelContract
from elf_runtime.model import bundled_model
from elf_runtime.model.ort_format import to_ort
from helpers import ROOT, TINY, TINY_ALONE, textured

QUIET = ort.SessionOptions()
QUIET.log_severity_level = 3


def test_the_bundled_model_by_its_precision(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "alone.onnx"
    words = ["--elf", "int8", "--end-to-end", "rgb", "--set", "max_keypoints=99", "--set", "border=20"]
    words += ["-o", str(path)]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "held against the runtime's" in out
    assert f"wrote {path} (0.7 MB): vgg relu2_1, descriptors conv3_2" in out

    properties = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    contract, own = ModelContract.from_metadata(properties, "it"), ElfRuntime(bundled_model("int8")).contract
    assert (contract.detection.max_keypoints, contract.detection.border) == (99, 20)
    assert contract.end_to_end is not None
    assert contract.end_to_end.color == "rgb"
    assert contract.parity["alone_near"] >= 0.98
    assert contract.command == f"{own.command} --end-to-end rgb --set max_keypoints=99 --set border=20"

    image = cv2.imread(str(ROOT / "demo" / "palace.jpg"))
    keypoints, _, _ = ort.InferenceSession(path, QUIET).run(None, {"image": image[None, ..., ::-1]})
    wanted = ElfRuntime(bundled_model("int8")).detect(image, max_keypoints=99, border=20)
    assert len(keypoints) == len(wanted) == 99
    assert np.mean(np.abs(keypoints - wanted.keypoints).max(axis=1) < 0.01) > 0.97

    assert main(words) == 1
    assert "exists; --force overwrites it" in capsys.readouterr().err
    assert main(["--elf", str(path), "--end-to-end", "-o", str(tmp_path / "b.onnx")]) == 1
    assert "gives keypoints itself already" in capsys.readouterr().err


def test_a_file_that_is_none_or_that_can_t(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def error(*words: str) -> str:
        assert main([*words, "-o", str(tmp_path / "out.onnx")]) == 1
        return capsys.readouterr().err

    absent = tmp_path / "absent.onnx"
    assert f"{absent}: no such file" in error("--elf", str(absent), "--end-to-end")
    frozen = to_ort(TINY, tmp_path / "tiny.ort")
    assert f"{frozen}: not an .onnx file" in error("--elf", str(frozen), "--end-to-end")
    assert "a graph can't hold" in error("--elf", str(TINY), "--end-to-end", "--set", "oriented=true")
    assert "unknown detection setting" in error("--elf", str(TINY), "--end-to-end", "--set", "no_such_setting=1")
    assert not (tmp_path / "out.onnx").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--elf", "int8"], "--elf needs --end-to-end"),
        (["--elf", "int8", "--end-to-end", "--net", "vgg"], "--net does not go with it"),
        (["--elf", "int8", "--end-to-end", "--precision", "int8"], "--precision does not go with it"),
        (["--elf", "int8", "--match"], "--elf does not go with it"),
        (["--elf", "int8", "--end-to-end", "uint8", "float32"], "pixels are uint8 or float32, not both"),
        (["--net", "vgg", "--end-to-end", "rgb", "bgr"], "pixels are bgr or rgb, not both"),
        (["--elf", "fp32", "--end-to-end", "opencv"], "--end-to-end opencv needs --rounds"),
    ],
)
def test_what_does_not_go_with_it(words: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2
    assert told in capsys.readouterr().err


def test_onnxruntime_s_tool_lists_what_a_reduced_build_needs(tmp_path: Path) -> None:
    (tmp_path / "alone.onnx").write_bytes(TINY_ALONE.read_bytes())
    words = ["--optimization_style", "Fixed", "--enable_type_reduction", str(tmp_path)]
    command = [sys.executable, "-m", "onnxruntime.tools.convert_onnx_models_to_ort", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    listed = (tmp_path / "required_operators_and_types.config").read_text(encoding="utf-8")
    assert "TopK" in listed
    assert "Loop" in listed
    image = textured(120, 160)
    found, wanted = (ElfRuntime(path).detect(image) for path in (tmp_path / "alone.ort", TINY_ALONE))
    assert len(found) > 3
    np.testing.assert_allclose(found.keypoints, wanted.keypoints, atol=1e-3)
