"""`--pool average` and `--desc-scale`: in the file, its contract, and what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
import torch
import torch.nn.functional as F
from onnx import helper

from elf_export import Compression, ExportError, LayerError, Reduction, export_network, export_onnx
from elf_export.cli import main
from elf_export.graph.graph import Graph
from elf_export.sources.networks import get_network
from elf_runtime import ElfRuntime, ModelContract
from elf_runtime.commands.info import main as info
from export.small_models import convolutions, model, nchw, weights
from helpers import textured
from seeded import seeded_weights

RATIO = 0.75


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("foreign") / "small.onnx"
    onnx.save(nchw(("N", 3, "H", "W")), file)
    return file


@pytest.fixture(scope="module")
def varied(foreign: Path) -> Path:
    out = foreign.with_name("varied.onnx")
    export_onnx(foreign, "relu2", ["relu1", "relu2"], out, pool="average", desc_scale=RATIO)
    return out


def small_torch(x: torch.Tensor, average: bool) -> torch.Tensor:
    tensors = {t.name: torch.tensor(onnx.numpy_helper.to_array(t)).double() for t in nchw().graph.initializer}
    pool = F.avg_pool2d if average else F.max_pool2d
    x = pool(F.relu(F.conv2d(x, tensors["w1"], tensors["b1"], padding=1)), 2)
    return F.relu(F.conv2d(x, tensors["w2"], padding=1))


def standardized(image: np.ndarray) -> torch.Tensor:
    x = torch.tensor(image[:, :, ::-1].copy()).double().permute(2, 0, 1)[None]  # anyone's model sees RGB
    return (x - x.mean()) / x.std(correction=0)


def test_the_saliency_is_that_of_the_averaging_network(varied: Path) -> None:
    image = textured(64, 88)
    x = standardized(image).requires_grad_(True)
    feature = small_torch(x, average=True)
    (gradient,) = torch.autograd.grad(feature, x, grad_outputs=feature.detach())
    wanted = gradient.abs().mean(dim=1)[0].numpy()
    found = ElfRuntime(varied).saliency(image)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * wanted.max())


def test_descriptors_are_those_of_the_smaller_image(varied: Path) -> None:
    """By torch's own resizing, maxima and all; and a place finds the cell that sees it."""
    image = textured(64, 88)
    small = F.interpolate(standardized(image), scale_factor=RATIO, mode="bilinear", align_corners=False,
                          recompute_scale_factor=False)  # fmt: skip
    wanted = small_torch(small, average=False)[0].numpy()
    elf = ElfRuntime(varied)
    spec = elf.contract.descriptor("relu2")
    assert spec is not None
    assert spec.scale == RATIO
    # Cell i of the map is centred at pixel 1/2 + 2 i of the smaller image.
    assert spec.stride == pytest.approx(2 / RATIO)
    assert spec.offset == pytest.approx(1.0 / RATIO - 0.5)
    seen = np.argwhere(np.linalg.norm(wanted, axis=0) > 0.1 * wanted.max())  # row, column
    cells = seen[((seen > 1) & (seen < np.array(wanted.shape[1:]) - 2)).all(axis=1)]
    assert len(cells) > 50
    points = spec.offset + cells[:, ::-1] * spec.stride
    found = elf.describe(image, points.astype(np.float32), "relu2")
    rows = wanted[:, cells[:, 0], cells[:, 1]].T
    np.testing.assert_allclose(found, rows / np.linalg.norm(rows, axis=1, keepdims=True), atol=1e-4)


def test_detect_describe_and_batches_agree(varied: Path) -> None:
    elf = ElfRuntime(varied)
    images = [textured(64, 88), textured(71, 53, 1)]
    for image, both in zip(images, elf.detect_batch(images, threshold="none"), strict=True):
        alone = elf.detect(image, threshold="none")
        assert len(alone) > 5
        np.testing.assert_array_equal(alone.keypoints, both.keypoints)
        np.testing.assert_allclose(elf.describe(image, alone.keypoints), alone.descriptors, atol=1e-5)


def test_the_contract_says_what_was_done(varied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    contract = ElfRuntime(varied).contract
    assert contract.pooling == "average"
    assert "--pool average --desc-scale 0.75" in contract.command
    assert ModelContract.from_metadata(contract.to_metadata(), "again") == contract
    assert info([str(varied)]) == 0
    out = capsys.readouterr().out
    assert "average, for the detector" in out
    assert "of the image at 0.75" in out


def test_an_input_and_a_layer_may_have_the_names_of_ours(foreign: Path, varied: Path, tmp_path: Path) -> None:
    graph = Graph(onnx.load(foreign))
    graph.rename({graph.inputs[0]: "image", "relu1": "descriptors_relu2"})
    onnx.save(graph.model, tmp_path / "named.onnx")
    again = export_onnx(
        tmp_path / "named.onnx", "relu2", ["descriptors_relu2", "relu2"], tmp_path / "out.onnx", pool="average",
        desc_scale=RATIO,
    ).path  # fmt: skip
    picture = textured(48, 64)
    found, wanted = (ElfRuntime(path, threads=1) for path in (again, varied))
    np.testing.assert_allclose(found.saliency(picture), wanted.saliency(picture), rtol=1e-5)
    for name, layer in (("descriptors_relu2", "relu1"), ("relu2", "relu2")):
        a, b = (
            found.describe(picture, [[20, 20], [40, 31]], name),
            wanted.describe(picture, [[20, 20], [40, 31]], layer),
        )
        np.testing.assert_allclose(a, b, atol=1e-5)


def test_a_file_without_them_says_nothing_of_them(foreign: Path, tmp_path: Path) -> None:
    plain = export_onnx(foreign, "relu2", ["relu1"], tmp_path / "plain.onnx")
    metadata = plain.contract.to_metadata()
    assert "elf.pooling" not in metadata
    assert "scale" not in metadata["elf.descriptors"]


def test_layers_and_other_networks_keep_their_names(tmp_path: Path) -> None:
    result = export_network(
        "vgg", "relu2_1", ["relu3_1", "superpoint:relu1a"], tmp_path / "two.onnx", offline=True, pool="average",
        desc_scale=0.5, desc_weights=seeded_superpoint(tmp_path),
    )  # fmt: skip
    assert [(d.layer, d.output, d.stride, d.scale) for d in result.contract.descriptors] == [
        ("relu3_1", "descriptors_relu3_1", 8.0, 0.5),
        ("superpoint:relu1a", "descriptors_superpoint_relu1a", 2.0, 0.5),
    ]
    assert result.contract.input.min_size == 32
    assert "Oxford" in result.contract.weights.source


def seeded_superpoint(folder: Path) -> Path:
    file = folder / "superpoint.npz"
    np.savez(file, **seeded_weights(get_network("superpoint").tensor_shapes(["relu1a"])))
    return file


def test_what_both_see_alike_is_computed_once(tmp_path: Path) -> None:
    """Without a scale of its own, the describing copy shares all up to the first pooling."""
    result = export_network("vgg", "relu2_1", ["relu2_2"], tmp_path / "one.onnx", offline=True, pool="average")
    names = [node.name for node in onnx.load(result.path).graph.node]
    assert not any("conv1_1" in name for name in names if name.startswith("vgg/"))
    assert sum("pre/standardized" in name for name in names) == 1


def test_with_compression_and_reduction(tmp_path: Path) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    for seed in range(3):
        cv2.imwrite(str(folder / f"{seed}.png"), textured(90, 120, seed))
    nodes, tensors = convolutions()
    tensors |= {"w1": weights(24, 3, 3, 3), "b1": weights(24, seed=1), "w2": weights(24, 24, 3, 3, seed=2)}
    onnx.save(model(nodes, tensors, ("N", 3, "H", "W"), "relu2"), tmp_path / "wide.onnx")
    result = export_onnx(
        tmp_path / "wide.onnx", "relu2", ["relu2"], tmp_path / "all.onnx", pool="average", desc_scale=0.5,
        reduction=Reduction(16), calibration=folder,
        compression=Compression(ranks={"conv2": 12, "wide:conv2": 16}),
    )  # fmt: skip
    assert result.contract.compression is not None
    assert result.contract.compression.ranks == {"head/conv2": 12, "wide:head/conv2": 16}
    features = ElfRuntime(result.path).detect(textured(96, 128), threshold="none")
    assert features.descriptors.shape == (len(features), 16)
    assert len(features) > 5


@pytest.mark.parametrize("name", ["xception", "squeezenet", "alexnet"])
def test_named_networks_average_as_torch_does(name: str, tmp_path: Path) -> None:
    """The export's own check: strides of 2 under windows of 3, ceil mode, and SAME padding."""
    network = get_network(name)
    layer = {"xception": "block2-pool", "squeezenet": "fire2", "alexnet": "conv2"}[name]
    weights = tmp_path / "seeded.npz"
    np.savez(weights, **seeded_weights(network.tensor_shapes([layer])))
    result = export_network(name, layer, [], tmp_path / "a.onnx", weights=weights, offline=True, pool="average")
    assert result.contract.pooling == "average"
    assert any(node.op_type == "AveragePool" for node in onnx.load(result.path).graph.node)


def test_what_cant_be_is_refused(foreign: Path, tmp_path: Path) -> None:
    out = tmp_path / "no.onnx"
    with pytest.raises(LayerError, match="no max-pooling"):
        export_onnx(foreign, "relu1", [], out, pool="average")
    with pytest.raises(ExportError, match="pooling is one of max, average, not 'mean'"):
        export_onnx(foreign, "relu2", [], out, pool="mean")
    for scale in (0.0, 5.0, float("nan"), True):
        with pytest.raises(ExportError, match="scale is a number from"):
            export_onnx(foreign, "relu2", ["relu1"], out, desc_scale=scale)
    with pytest.raises(ExportError, match="no layer that describes"):
        export_onnx(foreign, "relu2", [], out, desc_scale=0.5)
    nodes, tensors = convolutions()
    tensors["table"] = np.ones((1, 6, 64, 64), np.float32)
    nodes.insert(2, helper.make_node("Mul", ["relu1", "table"], ["scaled"], name="scaled"))
    nodes[3].input[0] = "scaled"
    fixed = tmp_path / "fixed.onnx"
    onnx.save(model(nodes, tensors, (1, 3, 64, 64), "relu2"), fixed)
    with pytest.raises(LayerError, match="64x64 only"):
        export_onnx(fixed, "relu2", ["relu1"], out, desc_scale=0.5)
    assert not out.exists()


def test_the_command(foreign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "by-command.onnx"
    words = ["--onnx", str(foreign), "--layer", "relu2", "--desc", "relu1", "-o", str(out)]
    assert main([*words, "--pool", "average", "--desc-scale", "1/2"]) == 0
    assert ElfRuntime(out).contract.descriptors[0].scale == 0.5
    assert main([*words, "--force", "--desc-scale", "9"]) != 0
    assert "0.125 to 4" in capsys.readouterr().err
