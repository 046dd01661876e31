"""`--compress` in the graph: the networks, their convolutions by name, the contract, and what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import helper

from elf_export import Compression, ExportError, LayerError, Reduction, export_network, export_onnx
from elf_export.cli import main
from elf_export.compression.convolutions import convolutions, named
from elf_export.graph.graph import Graph
from elf_export.graph.passes import factor_convs
from elf_export.sources import torch_saliency
from elf_runtime import ElfRuntime, ModelContract
from elf_runtime.commands.info import main as info
from export.small_models import model as small_model
from export.small_models import weights
from helpers import textured

CALIBRATION = 3


def network(depthwise: bool = False, batchnorm: bool = False) -> onnx.ModelProto:
    """conv1 of 3 to 16 channels, conv2 of 16 to 24 with a stride, conv3 of 24 to 32, pointwise of 32 to 24."""
    nodes = [
        helper.make_node("Conv", ["x", "w1", "b1"], ["conv1"], name="block/conv1", pads=[1] * 4),
        helper.make_node("Relu", ["conv1"], ["relu1"], name="block/relu1"),
        helper.make_node("Conv", ["relu1", "w2"], ["conv2"], name="block/conv2", pads=[1] * 4, strides=[2, 2]),
        helper.make_node("Relu", ["conv2"], ["relu2"], name="block/relu2"),
        helper.make_node("Conv", ["relu2", "w3", "b3"], ["conv3"], name="head/conv3", pads=[2] * 4, dilations=[2, 2]),
        helper.make_node("Relu", ["conv3"], ["relu3"], name="head/relu3"),
        helper.make_node("Conv", ["relu3", "w4"], ["pointwise"], name="head/pointwise"),
    ]
    tensors = {
        "w1": weights(16, 3, 3, 3), "b1": weights(16, seed=1), "w2": weights(24, 16, 3, 3, seed=2),
        "w3": weights(32, 24, 3, 3, seed=3), "b3": weights(32, seed=4), "w4": weights(24, 32, 1, 1, seed=5),
    }  # fmt: skip
    if batchnorm:
        nodes[1].input[0] = "norm1"
        nodes[3].input[0] = "norm2"
        for i, channels in ((1, 16), (2, 24)):
            parts = [f"{part}{i}" for part in ("scale", "shift", "mean", "variance")]
            norm = helper.make_node("BatchNormalization", [f"conv{i}", *parts], [f"norm{i}"])
            nodes.insert(3 * i - 2, norm)
            tensors |= {name: np.abs(weights(channels, seed=k)) + 0.5 for k, name in enumerate(parts)}
    if depthwise:
        nodes[4] = helper.make_node("Conv", ["relu2", "w3"], ["conv3"], name="head/conv3", pads=[1] * 4, group=8)
        tensors |= {"w3": weights(32, 3, 3, 3, seed=3)}
        tensors.pop("b3")
    return small_model(nodes, tensors, ("N", 3, "H", "W"), "pointwise")


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    for seed in range(CALIBRATION):
        cv2.imwrite(str(folder / f"{seed}.png"), textured(90, 120, seed))
    return folder


def run(model: onnx.ModelProto, feed: np.ndarray, *outputs: str) -> list[np.ndarray]:
    session = ort.InferenceSession(model.SerializeToString())
    return session.run(list(outputs) or None, {session.get_inputs()[0].name: feed})


def test_a_conv_becomes_two_that_make_its_value() -> None:
    net = network()
    kernels = {}
    for name, w, b in (("conv2", "w2", None), ("conv3", "w3", "b3")):
        tensors = {t.name: onnx.numpy_helper.to_array(t).astype(np.float64) for t in net.graph.initializer}
        eye = np.eye(len(tensors[w]))
        kernels[name] = (tensors[w], tensors[b] if b else np.zeros(len(eye)), eye[:, :, None, None], np.zeros(len(eye)))
    x = textured(41, 52).astype(np.float32).transpose(2, 0, 1)[None] / 50
    factored = factor_convs(Graph(net), kernels).model
    assert sum(node.op_type == "Conv" for node in factored.graph.node) == 6
    assert {"w2", "w3", "b3"}.isdisjoint(tensor.name for tensor in factored.graph.initializer)
    (wanted,), (found,) = run(net, x), run(factored, x)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


@pytest.mark.parametrize(
    ("net", "names"),
    [
        # The first has an image for its input; two 1x1 of 32 to 24 by 8 take less than one.
        (network(), ["block/conv2", "head/conv3", "head/pointwise"]),
        (network(depthwise=True), ["block/conv2", "head/pointwise"]),
    ],
)
def test_convolutions_that_gain(net: onnx.ModelProto, names: list[str]) -> None:
    graph = Graph(net)
    found = convolutions(graph, ["pointwise"])
    assert [conv.name for conv in found] == names
    assert [conv.rectified for conv in found] == [name != "head/pointwise" for name in names]
    assert not convolutions(graph, ["conv2"])[0].rectified
    for wanted in ("block/conv2", "conv2"):
        assert named(found, graph, wanted).result == "conv2"
    with pytest.raises(LayerError, match=r"--compress 'conv1' is no convolution .*; there are block/conv2, "):
        named(found, graph, "conv1")


def test_the_end_of_two_names_is_refused() -> None:
    net = network()
    net.graph.node[4].name = "head/conv2"
    graph = Graph(net)
    with pytest.raises(LayerError, match="'onv2' is the end of 2 convolutions' names"):
        named(convolutions(graph, []), graph, "onv2")


@pytest.mark.usefixtures("one_direction")
@pytest.mark.parametrize("batchnorm", [False, True])
def test_anyone_s_network(tmp_path: Path, pictures: Path, batchnorm: bool, capsys: pytest.CaptureFixture[str]) -> None:
    onnx.save(network(batchnorm=batchnorm), tmp_path / "net.onnx")
    lines: list[str] = []
    wanted = Compression.parse("conv2=8,conv3=16")
    result = export_onnx(
        tmp_path / "net.onnx", "relu2", ["relu3"], tmp_path / "a.onnx", compression=wanted, calibration=pictures,
        log=lines.append,
    )  # fmt: skip
    contract = ElfRuntime(result.path).contract
    assert contract == result.contract
    assert contract.compression is not None
    assert contract.compression.ranks == {"block/conv2": 8, "head/conv3": 16}
    assert contract.compression.calibration == f"3 images of {pictures.name}"
    assert "--compress conv2=8,conv3=16" in contract.command
    spent = 2 * 8 * (16 * 9 + 24) + 16 * (24 * 9 + 32)
    whole = 2 * 24 * 16 * 9 + 32 * 24 * 9
    assert contract.compression.multiply_adds == pytest.approx(spent / whole)
    assert contract.parity["derivative_median_error"] < 1e-6
    assert 0.5 < contract.parity["compressed_correlation"] <= 1
    assert {"compressed_ms_whole", "compressed_mma@1"} <= contract.parity.keys()
    header, plain, compressed = next(line for line in lines if "MMA@1" in line).splitlines()
    assert (plain.split()[:3], compressed.split()[0]) == (["whole", "1", "100%"], "compressed")
    assert len(header.split("(")[0].replace("kpts < 1 px", "k").replace(" %", "").split()) == len(plain.split()) - 1
    assert info([str(result.path)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "compression convolutions in low rank: block/conv2 8, head/conv3 16; " in shown


@pytest.mark.usefixtures("one_direction")
def test_nearly_all_energy_leaves_nearly_the_same_saliency(tmp_path: Path, pictures: Path) -> None:
    """conv2's kernels span 8 of 24 dimensions: so low a rank loses nothing."""
    net = network()
    mixed = np.tensordot(weights(24, 8, seed=7), weights(8, 16, 3, 3, seed=8), axes=1)
    (tensor,) = (t for t in net.graph.initializer if t.name == "w2")
    tensor.CopyFrom(onnx.numpy_helper.from_array(mixed, "w2"))
    onnx.save(net, tmp_path / "net.onnx")
    kwargs = {"calibration": pictures}
    whole = export_onnx(tmp_path / "net.onnx", "relu2", ["relu3"], tmp_path / "a.onnx")
    low = export_onnx(
        tmp_path / "net.onnx", "relu2", ["relu3"], tmp_path / "b.onnx", compression=Compression(ranks={"conv2": 8}),
        **kwargs,
    )  # fmt: skip
    pixels = textured(96, 128, 9).astype(np.float32)[None]
    for name in ("saliency", "descriptors_relu3"):
        one, other = (run(onnx.load(result.path), pixels, name)[0] for result in (whole, low))
        np.testing.assert_allclose(other, one, atol=1e-4 * np.abs(one).max())
    assert low.contract.parity["compressed_agreeing"] > 0.95
    again = export_onnx(
        tmp_path / "net.onnx", "relu2", ["relu3"], tmp_path / "c.onnx", compression=Compression(energy=0.9999), **kwargs
    )
    assert again.contract.compression is not None
    assert again.contract.compression.ranks["block/conv2"] == 8


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("conv9=8", "'conv9' is no convolution that can be compressed; there are block/conv2, "),
        ("conv2=23", r"--compress block/conv2=23 saves no arithmetic; at most 20 of its channels do"),
        ("0.01", "ranks of 8, the smallest, take 0"),
    ],
)
def test_what_can_t_be_done(tmp_path: Path, pictures: Path, text: str, message: str) -> None:
    onnx.save(network(), tmp_path / "net.onnx")
    with pytest.raises(ExportError, match=message):
        export_onnx(
            tmp_path / "net.onnx", "relu2", ["relu3"], tmp_path / "a.onnx", compression=Compression.parse(text),
            calibration=pictures,
        )  # fmt: skip
    assert not (tmp_path / "a.onnx").exists()


def test_nothing_to_compress(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="no convolution of the network takes less arithmetic in low rank"):
        export_network("sobel", "magnitude", [], tmp_path / "a.onnx", compression=Compression(ratio=0.5))


def test_the_command(tmp_path: Path, pictures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    onnx.save(network(), tmp_path / "net.onnx")
    words = ["--onnx", str(tmp_path / "net.onnx"), "--layer", "relu2", "--desc", "none", "-o", str(tmp_path / "a.onnx")]
    assert main([*words, "--compress", "some"]) == 1
    assert "--compress 'some' is none of a ratio" in capsys.readouterr().err
    assert main([*words, "--compress", "0.6", "--calibration", str(pictures)]) == 0
    out = capsys.readouterr().out
    assert "of the multiply-adds of the 1 convolutions that can be" in out
    assert "compressed" in out.splitlines()[-2]


@pytest.mark.usefixtures("one_direction")
def test_a_named_network_in_8_bits(tmp_path: Path, pictures: Path) -> None:
    result = export_network(
        "vgg", "pool1", ["conv3_1"], tmp_path / "a.onnx", offline=True, calibration=pictures, precision="int8",
        compression=Compression(ranks={"conv1_2": 16, "conv2_2": 32}), reduction=Reduction(32),
    )  # fmt: skip
    contract = result.contract
    assert contract.compression is not None
    assert contract.compression.ranks == {"conv1_2": 16, "conv2_2": 32}
    assert contract.parity["compressed_correlation"] > 0.9
    assert contract.parity["lower_correlation"] > 0.8
    assert len(ElfRuntime(result.path).detect(textured(120, 160, 3))) > 10
    with pytest.raises(ExportError, match=r"its convolutions are compressed \(conv1_2=16,conv2_2=32\)"):
        torch_saliency.load(result.path)


@pytest.mark.usefixtures("one_direction")
def test_a_network_that_describes_is_compressed_too(tmp_path: Path, pictures: Path) -> None:
    result = export_network(
        "sobel", "magnitude", ["vgg:pool2"], tmp_path / "a.onnx", offline=True, calibration=pictures,
        compression=Compression(ranks={"vgg:conv1_2": 16}), reduction=Reduction(16),
    )  # fmt: skip
    assert result.contract.compression is not None
    assert result.contract.compression.ranks == {"vgg:conv1_2": 16}
    assert result.contract.parity["descriptor_error"] < 1e-3
    assert result.contract.parity["compressed_correlation"] == pytest.approx(1)


def test_older_files_say_nothing_of_it() -> None:
    contract = ModelContract("vgg", "pool1", 2.0)
    assert "elf.compression" not in contract.to_metadata()
    assert ModelContract.from_metadata(contract.to_metadata(), "a.onnx").compression is None


def test_a_layer_that_is_projected_has_its_low_rank_by_that(tmp_path: Path, pictures: Path) -> None:
    """Fewer directions than the descriptor has values would be left of it."""
    onnx.save(network(), tmp_path / "net.onnx")
    said: list[str] = []
    with pytest.raises(ExportError, match=r"'conv3' is no convolution that can be compressed; there are block/conv2$"):
        export_onnx(
            tmp_path / "net.onnx", "relu2", ["conv3"], tmp_path / "a.onnx", compression=Compression(ranks={"conv3": 8}),
            calibration=pictures, reduction=Reduction(16), log=said.append,
        )  # fmt: skip
