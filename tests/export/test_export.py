"""elf-export as a user runs it: every layer and every option."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from elf_export import ExportError, export_network
from elf_export.checks.pictures import probe_images
from elf_export.checks.torch_reference import torch_saliency
from elf_export.cli import main
from elf_export.graph.sizes import Sizes
from elf_export.saliency import build_saliency
from elf_export.sources.forward import NETWORK_INPUT, torch_to_onnx
from elf_export.sources.networks import get_network
from elf_export.sources.networks.vgg import LAYERS, tensor_shapes
from elf_export.sources.sizes.finished import sizes_that_run
from elf_export.sources.weights.load import load_weights
from elf_runtime import ElfRuntime, preset
from elf_runtime.model.bundled import BUNDLED, bundled_model
from helpers import ROOT, shared, textured
from seeded import evaluator64, seeded_weights

TRUNK = LAYERS[: LAYERS.index("relu3_2") + 1]


@pytest.fixture(scope="module")
def random_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seeded weights for all of VGG16: real ones reach relu3_2 only without a download."""
    rng = np.random.default_rng(0)
    tensors = {}
    for name, shape in tensor_shapes(LAYERS).items():
        fan_in = np.prod(shape[1:]) if len(shape) > 1 else 1
        tensors[name] = (rng.standard_normal(shape) * np.sqrt(2 / fan_in) * (len(shape) > 1)).astype(np.float32)
    path = tmp_path_factory.mktemp("weights") / "random.npz"
    np.savez(path, **tensors)
    return path


def test_the_command_writes_one_verified_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "elf.onnx"
    arguments = ["--net", "vgg", "--layer", "pool2", "--desc", "relu3_2,pool2", "--offline", "-o", str(path)]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "240x176" in out
    assert "239x177" in out
    assert [p.name for p in tmp_path.iterdir()] == ["elf.onnx"]
    elf = ElfRuntime(path)
    c = elf.contract
    assert (c.network, c.layer, c.stride) == ("vgg", "pool2", 4.0)
    assert [(d.layer, d.dim, d.stride, d.offset) for d in c.descriptors] == [
        ("relu3_2", 256, 4.0, 1.5), ("pool2", 128, 4.0, 1.5)
    ]  # fmt: skip
    assert c.parity["keypoint_agreement"] >= 0.99
    assert c.weights.licence == "CC BY 4.0"
    # By hand, per pixel: conv1_1 64*27 + conv1_2 64*576 + (conv2_1 128*576 + conv2_2 128*1152) / 4, and back.
    by_hand = 2 * (64 * 27 + 64 * 576 + 128 * 576 / 4 + 128 * 1152 / 4)
    # A little more for the pools' comparisons, and for one more row and column of their gradients' phases.
    assert by_hand <= c.cost["saliency_macs_per_pixel"] < 1.03 * by_hand
    image = textured(96, 128)
    f = elf.detect(image, border=4)
    assert f.descriptors.shape == (len(f), 256)
    assert elf.describe(image, f.keypoints, descriptor="pool2").shape == (len(f), 128)

    assert main(arguments) == 1
    assert "exists; --force overwrites it" in capsys.readouterr().err
    before = path.read_bytes()
    assert main([*arguments, "--force", "--desc", "none"]) == 0
    assert path.read_bytes() != before
    g = ElfRuntime(path).detect(image, border=4)
    assert g.descriptors.shape == (len(g), 0)


@pytest.mark.usefixtures("small_probes")
@pytest.mark.parametrize("layer", [layer for layer in TRUNK if layer != "pool2"])
def test_every_layer_of_the_trunk(tmp_path: Path, layer: str) -> None:
    result = export_network("vgg", layer, [], tmp_path / "a.onnx", offline=True)
    assert all(check.passed for check in result.checks)


@pytest.mark.parametrize("layer", ["conv3_3", "pool3", "conv4_1", "pool5"])
def test_deep_layers(tmp_path: Path, layer: str, random_weights: Path) -> None:
    result = export_network("vgg", layer, ["pool5"], tmp_path / "a.onnx", weights=random_weights)
    assert all(check.passed for check in result.checks)
    assert result.contract.weights.source == "random.npz, unverified"
    elf = ElfRuntime(result.path)
    assert result.contract.input.min_size == 32
    for size in ((32, 32), (32, 36), (39, 33)):
        assert elf.saliency(textured(*size)).shape == size


def test_the_smallest_size_is_one_that_the_finished_graph_runs_on() -> None:
    """A graph for images of 64 pixels on may have a convolution that takes no smaller ones, from 40 on here."""
    network = get_network("vgg")
    module = network.build(seeded_weights(network.tensor_shapes(["conv4_1"])), ["conv4_1"])
    forward = torch_to_onnx(module, ["conv4_1"], 3)
    for least, wanted in ((32, 32), (64, 48)):
        model = build_saliency(forward, "conv4_1", [], NETWORK_INPUT, network.preprocessing, min_size=least)
        assert any(node.name.endswith("/composed/inside") for node in model.graph.node) == (least == 64)
        assert sizes_that_run(model, Sizes(), 3, 1.0, ()).min_size == wanted
    with pytest.raises(ExportError, match=r"runs the saliency graph at no size that was tried: .*Invalid input shape"):
        sizes_that_run(model, Sizes(36, 36), 3, 1.0, ())


@pytest.mark.parametrize("layer", ["relu4_3", "pool4", "conv5_2"])
def test_deep_layers_in_float64_are_exact(layer: str) -> None:
    """Small images do: without rounding no ReLU switches, which at this depth would show in every pixel."""
    network = get_network("vgg")
    module = network.build(seeded_weights(network.tensor_shapes([layer])), [layer])
    forward = torch_to_onnx(module, [layer], 3)
    evaluator = evaluator64(build_saliency(forward, layer, [], NETWORK_INPUT, network.preprocessing))
    images = [textured(33, 50, seed) for seed in range(2)]
    images[1][:16] = 77  # ties
    pixels = np.stack(images).astype(np.float64)
    (found,) = evaluator.run(["saliency"], {"image": pixels})
    wanted = torch_saliency(module, network.preprocessing)(pixels)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() <= 1e-10 * wanted.max()


@pytest.mark.usefixtures("small_probes")
@pytest.mark.parametrize("opset", [11, 12, 13, 16, 18, 20])
def test_opsets(tmp_path: Path, opset: int) -> None:
    result = export_network("vgg", "pool1", ["pool1"], tmp_path / "a.onnx", opset=opset, offline=True)
    model = onnx.load(result.path)
    assert [o.version for o in model.opset_import if o.domain == ""] == [opset]
    assert model.ir_version <= 10
    assert all(check.passed for check in result.checks)


def test_only_portable_standard_ops(vgg) -> None:
    assert {node.domain for node in vgg.model.graph.node} == {""}
    ops = {node.op_type for node in vgg.model.graph.node}
    assert not ops & {"MaxUnpool", "ScatterND", "ScatterElements", "GatherND", "If", "Loop"}
    # It would leave ONNX Runtime's blocked layout; the one there is puts the image's phases together.
    assert [node.name for node in vgg.model.graph.node if node.op_type == "ConvTranspose"] == ["saliency/sums"]
    pools = [node for node in vgg.model.graph.node if node.op_type == "MaxPool"]
    assert all(len(node.output) == 1 for node in pools)  # no Indices


def test_adjoint_nodes_are_named_after_their_forward_nodes(vgg) -> None:
    names = [node.name for node in vgg.model.graph.node]
    assert len(set(names)) == len(names)
    assert any(name.startswith("adj/pool2/") for name in names)


def test_the_plain_form_has_the_values_of_the_fast_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With nothing clever in it; 8 bits have a form of their own."""
    options = ["--net", "vgg", "--layer", "pool1", "--desc", "none", "--offline", "--quiet"]
    for lowering in ("fast", "plain"):
        assert main([*options, "--lowering", lowering, "-o", str(tmp_path / f"{lowering}.onnx")]) == 0
    fast, plain = (ElfRuntime(tmp_path / f"{lowering}.onnx") for lowering in ("fast", "plain"))
    assert "--lowering plain" in plain.contract.command
    assert "--lowering" not in fast.contract.command
    ops = {node.op_type for node in onnx.load(tmp_path / "plain.onnx").graph.node}
    assert "HardSigmoid" not in ops
    assert {"Sign", "ConvTranspose"} <= ops
    image = textured(120, 160)
    saliency = [elf.saliency(image) for elf in (fast, plain)]
    np.testing.assert_allclose(*saliency, rtol=0, atol=1e-5 * saliency[0].max())
    assert main([*options, "--lowering", "plain", "--precision", "int8", "-o", str(tmp_path / "8.onnx")]) == 1
    assert "8 bits gain in a form of their own only" in capsys.readouterr().err
    assert not (tmp_path / "8.onnx").exists()


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list"]) == 0
    assert "vgg" in capsys.readouterr().out
    assert main(["--net", "vgg", "--list"]) == 0
    out = capsys.readouterr().out
    assert all(layer in out for layer in LAYERS)
    (pool4,) = (line.split() for line in out.splitlines() if line.startswith("pool4"))
    assert pool4[1:7] == ["MaxPool", "512", "32x32", "16", "100", "px"]


@pytest.mark.usefixtures("small_probes")
def test_the_command_names_the_weights_and_the_opset(tmp_path: Path, random_weights: Path) -> None:
    """What the bundled model holds is found without, and is not named."""
    published = tmp_path / "published.npz"
    np.savez(published, **load_weights(get_network("vgg"), ["pool1"], offline=True).tensors)
    for options, words in (
        ({"weights": random_weights, "opset": 13}, "--weights random.npz --opset 13 --layer"),
        ({"weights": published}, "vgg --layer"),
        ({"opset": 17, "offline": True}, "vgg --layer"),
    ):
        result = export_network("vgg", "pool1", [], tmp_path / "a.onnx", force=True, **options)
        assert words in result.contract.command
    result = export_network("sobel", None, ["vgg:pool1"], tmp_path / "a.onnx", force=True, desc_weights=random_weights)
    assert "--desc-weights random.npz --layer" in result.contract.command


def test_the_verification_images_have_ties_and_keypoints() -> None:
    for label, image in probe_images(176, 240, 3):
        assert image.shape == (176, 240, 3)
        assert (image == np.floor(image)).all()
        flat = (image[:, 1:] == image[:, :-1]).all(axis=2).mean()
        assert flat > 0.1 if label == "cartoon" else flat < 0.01


@pytest.mark.parametrize("precision", BUNDLED)
def test_the_bundled_models_are_made_by_their_script(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, precision: str
) -> None:
    """Node for node and tensor for tensor, from the weights in the package.

    What is fitted to photographs depends on the last bits of convolutions in float32, and so on the processor.
    """
    script = runpy.run_path(str(ROOT / "tools" / "make_bundled_model.py"))
    monkeypatch.setattr(sys, "argv", ["make_bundled_model.py"])
    globals_ = script["main"].__globals__
    monkeypatch.setitem(globals_, "BUNDLED", {precision: BUNDLED[precision]})
    monkeypatch.setitem(globals_, "bundled_model", lambda _: tmp_path / "again.onnx")
    monkeypatch.setenv("ELF_OFFLINE", "1")
    assert script["main"]() == 0
    again, bundled = onnx.load(tmp_path / "again.onnx"), onnx.load(bundled_model(precision))
    assert [n.SerializeToString() for n in again.graph.node] == [n.SerializeToString() for n in bundled.graph.node]
    tensors, wanted = ({t.name: numpy_helper.to_array(t) for t in m.graph.initializer} for m in (again, bundled))
    assert list(tensors) == list(wanted)
    for name, tensor in tensors.items():
        fitted = precision == "int8" or name in ("descriptors_conv3_2/projection", "descriptors_conv3_2/offset")
        error = np.abs(tensor.astype(float) - wanted[name])
        assert tensor.dtype == wanted[name].dtype
        assert error.max() <= fitted * max(1e-5 * np.abs(wanted[name]).max(), tensor.dtype.kind == "i"), name
        # One rounding of few, one in a hundred of many, may go the other way.
        assert tensor.dtype.kind == "f" or np.count_nonzero(error) <= max(1, 0.01 * error.size), name
    its, ours = (ElfRuntime(path).contract for path in (tmp_path / "again.onnx", bundled_model(precision)))
    assert (its.layer, its.precision, its.command) == (ours.layer, precision, ours.command)
    assert its.weights == ours.weights
    assert its.detection == ours.detection == preset("default")


def test_real_weights_serve_the_paper_s_setting(tmp_path: Path) -> None:
    weights = shared("weights", "vgg16_oxford_imagenet.npz")
    result = export_network("vgg", output=tmp_path / "paper.onnx", weights=weights)
    c = result.contract
    assert (c.layer, c.descriptors[0].layer, c.descriptors[0].stride, c.descriptors[0].offset) == (
        "pool2", "pool4", 16.0, 7.5
    )  # fmt: skip
    assert "Oxford" in c.weights.source
