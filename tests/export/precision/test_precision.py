"""`--precision`: fewer bits as a user asks for them, and what is refused."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import onnx
import pytest

from elf_export import ExportError, export_network, export_onnx
from elf_export.cli import main
from elf_export.graph.passes import opset_of
from elf_export.sources.networks import get_network
from elf_runtime import ElfRuntime
from export import small_models as small
from helpers import shared, textured
from seeded import seeded_weights

SHARED = {
    "vgg": "vgg16_oxford_imagenet.npz",
    "alexnet": "alexnet_caffe_conv_8bit.npz",
    "xception": "xception_imagenet_entry_flow.npz",
    "squeezenet": "squeezenet1_1_imagenet_keras.npz",
    "superpoint": "superpoint_v1_encoder_descriptor.npz",
}


def weights_of(name: str, folder: Path) -> Path:
    if name in SHARED:
        return shared("weights", SHARED[name])
    network = get_network(name)
    path = folder / "seeded.npz"
    np.savez(path, **seeded_weights(network.tensor_shapes([network.default_layer, *network.default_descriptors])))
    return path


# Least correlation of the saliency with float32's on two drawn pictures.
LEAST = {"int8": 0.8, "fp16": 0.99, "bf16": 0.97}


@pytest.mark.usefixtures("small_probes")
@pytest.mark.parametrize(
    ("name", "precision"),
    [
        (name, precision)
        for name in ("alexnet", "xception", "squeezenet", "resnet18", "mobilenet_v2")
        for precision in LEAST
        if (name, precision) != ("alexnet", "int8")
    ],
)
def test_named_networks(tmp_path: Path, pictures: Path, name: str, precision: str) -> None:
    said: list[str] = []
    result = export_network(
        name, output=tmp_path / "a.onnx", weights=weights_of(name, tmp_path), precision=precision,
        calibration=pictures, log=said.append,
    )  # fmt: skip
    elf = ElfRuntime(result.path)
    assert elf.contract.precision == precision
    assert elf.contract.parity["lower_correlation"] > LEAST[precision]
    assert elf.contract.parity["keypoint_agreement"] >= 0.99  # float32's, against torch
    assert f"--precision {precision}" in elf.contract.command
    header, fp32, lower, *_ = said[-1].splitlines()
    assert header.split()[:7] == ["correlation", "kpts", "<", "1", "px", "keypoints", "rep"]
    assert (fp32.split()[0], lower.split()[0]) == ("fp32", precision)
    image = textured(131, 171, 7)
    found = elf.detect(image, threshold="none")
    assert len(found) > 20
    assert np.isfinite(found.descriptors).all()
    assert elf.saliency(image).dtype == np.float32


@pytest.mark.usefixtures("small_probes")
@pytest.mark.parametrize(
    ("name", "precision", "message"),
    [
        ("superpoint", "int8", "make no convolution of this network faster; use fp32, fp16 or bf16"),
        ("alexnet", "int8", "int8: 8-bit integers make no convolution of this network faster"),
        ("superpoint", "fp16", r"fp16 overflows in this network: its saliency is not finite\. No file was written"),
    ],
)
def test_what_a_network_does_not_survive(
    tmp_path: Path, pictures: Path, name: str, precision: str, message: str
) -> None:
    """SuperPoint's conv1a is one linear layer of large weights: 25 multiplications a pixel, up to 350000 each.

    AlexNet's response normalisation stays in floats, between its few convolutions.
    """
    with pytest.raises(ExportError, match=message):
        export_network(
            name, descriptors=[], output=tmp_path / "a.onnx", weights=weights_of(name, tmp_path),
            precision=precision, calibration=pictures,
        )  # fmt: skip
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("small_probes")
def test_the_command_in_the_file_makes_it_again(
    tmp_path: Path, pictures: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first = ["--net", "vgg", "--layer", "pool1", "--desc", "pool1", "--offline", "--precision", "int8"]
    settings = ["--set", "scale=0.5", "--set", "denoise=3,0.8", "--set", "subpixel=true", "--set", "threshold=none"]
    assert main([*first, *settings, "--calibration", str(pictures), "-o", "first.onnx"]) == 0
    contract = ElfRuntime("first.onnx").contract
    own = get_network("vgg").detection
    assert contract.detection == own.updated(scale=0.5, denoise=(3, 0.8), subpixel=True, threshold="none")
    program, *words = shlex.split(contract.command)
    assert program == "elf-export"
    assert main([*words, "--offline", "-o", "second.onnx"]) == 0
    assert Path("first.onnx").read_bytes() == Path("second.onnx").read_bytes()


@pytest.mark.parametrize("precision", ["int8", "fp16", "bf16"])
def test_anyone_s_model(tmp_path: Path, pictures: Path, precision: str) -> None:
    nodes, tensors = small.convolutions()
    tensors = {"w1": small.weights(32, 3, 3, 3), "b1": small.weights(32), "w2": small.weights(32, 32, 3, 3)}
    onnx.save(small.model(nodes, tensors, ("n", 3, "h", "w"), "relu2"), tmp_path / "model.onnx")
    result = export_onnx(
        tmp_path / "model.onnx", "relu2", ["relu2"], tmp_path / "elf.onnx", precision=precision, calibration=pictures
    )
    assert result.contract.precision == precision
    assert result.contract.parity["lower_correlation"] > LEAST[precision]


def test_a_model_that_would_be_slower_in_8_bits_is_refused(tmp_path: Path, pictures: Path) -> None:
    """Six channels, then four: rounding costs more than so few multiplications."""
    onnx.save(small.nchw(("n", 3, "h", "w")), tmp_path / "model.onnx")
    with pytest.raises(ExportError, match="make no convolution of this network faster; use fp32"):
        export_onnx(
            tmp_path / "model.onnx", "relu2", ["relu2"], tmp_path / "elf.onnx", precision="int8", calibration=pictures
        )
    assert not (tmp_path / "elf.onnx").exists()


@pytest.mark.usefixtures("small_probes")
@pytest.mark.parametrize("precision", ["int8", "fp16", "bf16"])
def test_old_opsets_are_refused(tmp_path: Path, precision: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--net", "vgg", "--layer", "conv1_1", "--desc", "none", "--offline", "--opset", "12"]
    assert main([*arguments, "--precision", precision, "-o", str(tmp_path / "a.onnx")]) == 1
    assert f"{precision} needs opset 13 or later; choose one with --opset" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_precision_that_there_is_none_of_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="precision is one of fp32, fp16, bf16, int8, not 'int4'"):
        export_network("vgg", "conv1_1", [], tmp_path / "a.onnx", offline=True, precision="int4")


def test_what_can_be_refused_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("elf_export.sources.named.load_weights", lambda *_: pytest.fail("weights were loaded before"))
    monkeypatch.setattr(
        "elf_export.sources.foreign.detector.prepare", lambda *_: pytest.fail("the model was prepared before")
    )
    for opset in (11, 17):
        onnx.save(small.nchw(opset=opset), tmp_path / f"{opset}.onnx")
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "broken.png").write_bytes(b"no image")
    net = ["--net", "vgg", "--offline", "-o", str(tmp_path / "a.onnx")]
    old, new = (["--onnx", str(tmp_path / f"{n}.onnx"), "--layer", "relu2", "--desc", "none"] for n in (11, 17))
    for words, message in (
        ([*net, "--opset", "11"], "the model is of opset 11, int8 needs opset 13 or later; choose one with --opset"),
        ([*old, "--opset", "11"], "the model is of opset 11, int8 needs opset 13 or later"),
        ([*new, "--opset", "12"], "the model is of opset 12, int8 needs opset 13 or later"),
        ([*net, "--calibration", str(tmp_path / "pictures")], "broken.png: not an image that OpenCV can decode"),
        ([*new, "--calibration", str(tmp_path / "pictures")], "broken.png: not an image that OpenCV can decode"),
    ):
        assert main([*words, "--precision", "int8"]) == 1
        assert message in capsys.readouterr().err


def test_a_model_of_an_older_opset_is_converted_to_what_the_precision_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    onnx.save(small.nchw(opset=11), tmp_path / "old.onnx")
    words = ["--onnx", str(tmp_path / "old.onnx"), "--layer", "relu2", "--desc", "none", "-o", str(tmp_path / "a.onnx")]
    assert main([*words, "--precision", "bf16"]) == 0
    assert "the model is of opset 11 and was converted to 13" in capsys.readouterr().out
    assert opset_of(onnx.load(tmp_path / "a.onnx")) == 13


@pytest.mark.usefixtures("small_probes")
def test_calibration_folders_that_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ["--net", "vgg", "--layer", "conv1_2", "--desc", "none", "--offline", "-o", str(tmp_path / "a.onnx")]
    with pytest.raises(SystemExit):
        main([*base, "--calibration", str(tmp_path)])
    assert "--calibration goes with --compress, --desc-dim or --precision only" in capsys.readouterr().err
    for folder, message in ((tmp_path / "nowhere", "not a folder of calibration images"), (tmp_path, "no image to")):
        assert main([*base, "--precision", "int8", "--calibration", str(folder)]) == 1
        assert message in capsys.readouterr().err
    (tmp_path / "broken.png").write_bytes(b"no image")
    assert main([*base, "--precision", "int8", "--calibration", str(tmp_path)]) == 1
    assert "broken.png: not an image that OpenCV can decode" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["broken.png"]
