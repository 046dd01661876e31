"""elf-export: what is refused, what is not written, and how it ends when it is stopped."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from elf_export import ExportError, LayerError, VerificationError, export_network
from elf_export.cli import main


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "vgg19"}, "unknown network 'vgg19'; known are vgg"),
        ({"layer": "pool7"}, "vgg has no layer 'pool7'; it has conv1_1"),
        ({"descriptors": ["fc6"]}, "no layer 'fc6'"),
        ({"opset": 9}, "opset 9 is not supported; choose 11 to 20"),
        ({"output": "folder.onnx"}, "is a folder"),
        ({"output": "a.ort"}, r"a\.ort: a model's name ends in \.onnx"),
        ({"output": "locked/a.onnx"}, "nothing can be written into the folder locked"),
        ({"name": "sobel", "layer": "magnitude", "weights": "any.npz"}, "--weights any.npz: sobel has no weights"),
        ({"desc_weights": "any.npz"}, "--desc-weights any.npz: no other network describes"),
        ({"output": "no/such/folder/a.onnx"}, "there is no folder no/such/folder"),
    ],
)
def test_what_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict, message: str) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("folder.onnx", "locked"):
        Path(folder).mkdir()
    monkeypatch.setattr(os, "access", lambda path, _: str(path) != "locked")
    monkeypatch.setattr(torch.onnx, "export", lambda *_, **__: pytest.fail("work was done"))
    arguments = {"name": "vgg", "layer": "pool1", "descriptors": [], "offline": True} | changes
    with pytest.raises(ExportError, match=message):
        export_network(**arguments)
    assert sorted(path.as_posix() for path in Path().rglob("*")) == ["folder.onnx", "locked"]


def test_unknown_layer_is_a_layer_error() -> None:
    with pytest.raises(LayerError):
        export_network("vgg", "pool9")


def test_a_graph_that_disagrees_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrong adjoint (the kernel not flipped) fails verification, exits non-zero, and leaves no file."""
    from elf_export.lowering import common, phases

    def unflipped(weight: np.ndarray, group: int) -> np.ndarray:
        return np.ascontiguousarray(weight.swapaxes(0, 1))

    monkeypatch.setattr(common, "flipped", unflipped)
    monkeypatch.setattr(phases, "transposed", lambda weight, group: unflipped(weight[..., ::-1, ::-1], group))
    with pytest.raises(VerificationError, match=r"(?s)disagrees with its reference.*No file was written"):
        export_network("vgg", "pool1", [], tmp_path / "a.onnx", offline=True)
    monkeypatch.chdir(tmp_path)
    assert main(["--net", "vgg", "--layer", "pool1", "--desc", "none", "--offline"]) == 1
    assert not list(tmp_path.iterdir())


def test_a_failing_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.onnx"
    path.write_bytes(b"old")

    def full_disk(self: Path, data: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(ExportError, match="No space left"):
        export_network("vgg", "conv1_1", [], path, force=True, offline=True)
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.onnx"]


def test_the_reader_of_a_list_may_have_seen_enough(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As `elf-export --list | head -1`: quiet, with a status of its own."""

    class Closed(io.TextIOWrapper):
        def write(self, text: str) -> int:
            raise BrokenPipeError(32, "Broken pipe")

    with open(tmp_path / "out", "wb") as file:
        monkeypatch.setattr(sys, "stdout", Closed(file))
        assert main(["--list"]) == 1


def test_an_interruption_is_one_line_and_has_the_shell_s_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    assert main(["--net", "sobel", "--desc", "none", "--offline", "-o", str(tmp_path / "a.onnx")]) == 130
    assert capsys.readouterr().err == "\nelf-export: interrupted\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("model", [["--net", "vgg"], ["--onnx", "a.onnx", "--layer", "a"]])
@pytest.mark.parametrize("text", ["", ",", " , "])
def test_an_empty_list_of_layers_is_not_none(model: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main([*model, "--desc", text])
    assert caught.value.code == 2
    assert f"--desc {text!r} names no layer; --desc none is for" in capsys.readouterr().err


def test_usage_errors(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main([])
    assert caught.value.code == 2
    assert "--net or --onnx is required" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["--net", "vgg", "--frobnicate"])


def test_the_working_scale_is_no_pixel_scale(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--net", "vgg", "--scale", "0.5"])
    assert capsys.readouterr().err.splitlines()[-1] == (
        "elf-export: error: --scale goes with --onnx only: it describes the image input of such a model, and a "
        "network of --net brings its own description; the working scale is --set scale=0.5"
    )
    with pytest.raises(SystemExit):
        main(["--onnx", "a.onnx", "--weights", "w.npz"])
    assert "it is about a network that comes with the exporter" in capsys.readouterr().err


def test_a_calibration_folder_is_looked_for_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def later(*_: object) -> None:
        raise AssertionError("weights were loaded before")

    monkeypatch.setattr("elf_export.sources.named.load_weights", later)
    arguments = ["--net", "vgg", "--precision", "int8", "--calibration", str(tmp_path / "none"), "--offline"]
    assert main([*arguments, "-o", str(tmp_path / "a.onnx")]) == 1
    assert "not a folder of calibration images" in capsys.readouterr().err
