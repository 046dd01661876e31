"""Models with shorter descriptors: the graph against numpy, and the fit at the working scale."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime as ort
import pytest

from elf_export import Preprocessing, Reduction, build_saliency, export_network, export_onnx
from elf_export.calibration import calibration_set
from elf_export.descriptors.projection import fit_layers, specs
from elf_export.graph.graph import Graph
from elf_export.graph.passes import project
from elf_runtime import ElfRuntime, InputSpec
from elf_runtime.commands.info import main as info
from export.descriptors.svd import by_svd
from export.small_models import convolutions as small_convolutions
from export.small_models import model as small_model
from export.small_models import nchw, nhwc, weights
from helpers import textured

MATRICES = np.random.default_rng(5)


def outputs(model: onnx.ModelProto, pixels: np.ndarray) -> dict[str, np.ndarray]:
    session = ort.InferenceSession(model.SerializeToString())
    names = [value.name for value in session.get_outputs()]
    return dict(zip(names, session.run(names, {session.get_inputs()[0].name: pixels}), strict=True))


def convolutions(model: onnx.ModelProto) -> int:
    return sum(node.op_type == "Conv" for node in model.graph.node)


@pytest.mark.parametrize(
    ("described", "more"),
    # A convolution's map takes the projection into its kernel, unless something else reads the map.
    [(["conv2"], 0), (["relu2"], 1), (["conv2", "relu2"], 2), (["conv1"], 1)],
)
def test_the_graph_projects_as_numpy_does(described: list[str], more: int) -> None:
    model = build_saliency(nchw(("N", 3, "H", "W")), "pool1", described)
    pixels = textured(37, 50).astype(np.float32).transpose(2, 0, 1)[None]
    before = outputs(model, pixels)
    maps = {}
    for layer in described:
        dim = before[f"descriptors_{layer}"].shape[-1]
        maps[f"descriptors_{layer}"] = (MATRICES.standard_normal((dim, 3)), MATRICES.standard_normal(3))
    projected = project(Graph(model), maps).model
    onnx.checker.check_model(projected, full_check=True)
    after = outputs(projected, pixels)
    for name, (matrix, bias) in maps.items():
        wanted = before[name].astype(np.float64) @ matrix + bias
        np.testing.assert_allclose(after[name], wanted, atol=1e-5 * np.abs(wanted).max())
    np.testing.assert_array_equal(after["saliency"], before["saliency"])
    assert convolutions(projected) - convolutions(model) == more


def test_a_convolution_in_groups_is_left_alone() -> None:
    nodes, tensors = small_convolutions()
    nodes.append(onnx.helper.make_node("Conv", ["relu2", "w3"], ["grouped"], group=2, pads=[1] * 4))
    net = small_model(nodes, tensors | {"w3": weights(6, 2, 3, 3, seed=4)}, (1, 3, 64, 64), "grouped")
    model = build_saliency(net, "pool1", ["grouped"])
    pixels = textured(64, 64).astype(np.float32).transpose(2, 0, 1)[None]
    before = outputs(model, pixels)["descriptors_grouped"]
    matrix, bias = MATRICES.standard_normal((6, 6)), MATRICES.standard_normal(6)
    projected = project(Graph(model), {"descriptors_grouped": (matrix, bias)}).model
    wanted = before.astype(np.float64) @ matrix + bias
    found = outputs(projected, pixels)["descriptors_grouped"]
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_maps_with_channels_last_are_projected_too() -> None:
    model = build_saliency(nhwc((1, 64, 64, 3)), "pool1", ["y"])
    pixels = textured(64, 64).astype(np.float32)[None]
    (name,) = (name for name in outputs(model, pixels) if name.startswith("descriptors"))
    before = outputs(model, pixels)[name]
    matrix, bias = MATRICES.standard_normal((before.shape[-1], 2)), MATRICES.standard_normal(2)
    wanted = before.astype(np.float64) @ matrix + bias
    found = outputs(project(Graph(model), {name: (matrix, bias)}).model, pixels)[name]
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_anyone_s_model_with_fewer_values(
    tmp_path: Path, photographs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    onnx.save(nchw(("N", 3, "H", "W")), tmp_path / "net.onnx")
    whole = export_onnx(tmp_path / "net.onnx", "pool1", ["conv2", "relu2"], tmp_path / "whole.onnx")
    reduction = Reduction(3, whiten=0.5)
    lines: list[str] = []
    made = [
        export_onnx(
            tmp_path / "net.onnx", "pool1", ["conv2", "relu2"], tmp_path / name, reduction=reduction,
            calibration=photographs, log=lines.append,
        )
        for name in ("one.onnx", "two.onnx")
    ]  # fmt: skip
    assert made[0].path.read_bytes() == made[1].path.read_bytes()
    assert any("descriptors relu2: 4 channels -> 3, largest error" in line for line in lines)
    contract = ElfRuntime(made[0].path).contract
    assert contract == made[0].contract
    assert contract.parity["descriptor_error"] < 1e-5
    assert "--desc-dim 3 --whiten 0.5 --calibration" in contract.command
    assert info([str(made[0].path)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "relu2: 3 values, a cell every 2 pixels; of 4 channels by pca, whitened by 0.5, " in shown
    assert f"fitted to 3 images of photographs (SHA-256 {contract.descriptors[1].reduction.sha256[:16]}...)" in shown
    elf, plain = ElfRuntime(made[0].path), onnx.load(whole.path)
    image = textured(90, 110, 9)
    photos = np.stack([cv2.imread(str(photographs / f"{k}.png"))[:, :, ::-1] for k in range(3)]).astype(np.float32)
    for spec, source in zip(contract.descriptors, whole.contract.descriptors, strict=True):
        assert (spec.dim, spec.stride, spec.offset) == (3, source.stride, source.offset)
        assert spec.reduction is not None
        assert (spec.reduction.method, spec.reduction.source_dim, spec.reduction.whiten) == ("pca", 4, 0.5)
        assert (spec.reduction.calibration, len(spec.reduction.sha256)) == ("3 images of photographs", 64)
        assert source.reduction is None
        # By SVD of the whole map's cells over the photographs, at the cells' centres in another image.
        cells = outputs(plain, photos)[source.output].reshape(-1, 4).astype(np.float64)
        _, s, v = np.linalg.svd(cells - cells.mean(axis=0), full_matrices=False)
        matrix = v[:3].T * (s[:3] / s[0]) ** -0.5
        found_map = outputs(plain, image[None, :, :, ::-1].astype(np.float32))[source.output][0]
        wanted = ((found_map - cells.mean(axis=0)) @ matrix)[2:40:5, 3:50:5].reshape(-1, 3)
        wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
        y, x = (grid.ravel() * spec.stride + spec.offset for grid in np.mgrid[2:40:5, 3:50:5])
        found = elf.describe(image, np.stack([x, y], axis=1), descriptor=spec.layer)
        signs = np.sign((found * wanted).sum(axis=0))
        np.testing.assert_allclose(found * signs, wanted, atol=1e-4)


def test_a_named_network_with_fewer_values(tmp_path: Path) -> None:
    result = export_network(
        "vgg",
        "pool1",
        ["pool2", "conv3_2"],
        tmp_path / "a.onnx",
        offline=True,
        reduction=Reduction(32, whiten=1.0),
    )
    assert [d.dim for d in result.contract.descriptors] == [32, 32]
    assert result.contract.parity["descriptor_error"] < 1e-4
    cost = result.contract.cost
    # conv3_2 has 32 kernels in place of 256; pool2 gets a 1x1 convolution, on cells of 4x4 pixels.
    block2, block3 = 9 * (64 * 128 + 128 * 128) / 4, 9 * (128 * 256 + 256 * 32) / 16
    by_hand = block2 + block3 + 128 * 32 / 16
    assert cost["descriptors_macs_per_pixel"] - cost["saliency_macs_per_pixel"] == pytest.approx(by_hand, rel=1e-3)


def test_another_network_s_layer_with_fewer_values(tmp_path: Path) -> None:
    result = export_network(
        "sobel",
        "magnitude",
        ["vgg:pool2"],
        tmp_path / "a.onnx",
        offline=True,
        reduction=Reduction(8, "channels"),
    )
    (spec,) = result.contract.descriptors
    assert (spec.layer, spec.dim) == ("vgg:pool2", 8)
    assert spec.reduction is not None
    assert (spec.reduction.method, spec.reduction.source_dim) == ("channels", 128)
    assert result.contract.parity["descriptor_error"] < 1e-5
    assert "--desc-dim 8 --desc-reduce channels" in result.contract.command


def test_the_fit_is_to_the_map_at_the_working_scale(photographs: Path) -> None:
    """The map of each photograph, halved by the mean of four pixels."""
    model = build_saliency(nchw(("N", 3, "H", "W")), "pool1", ["relu2"])
    net = build_saliency(nchw(("N", 3, "H", "W")), "pool1", ["relu2"], "x", Preprocessing("rgb", False))
    images, reduction = calibration_set(photographs), Reduction(2)
    found = fit_layers(net, ["relu2"], reduction, images, InputSpec(color="rgb", min_size=8), 0.5)["relu2"]
    rows = []
    for path in images.files:
        halved = cv2.imread(str(path)).astype(np.float64).reshape(30, 2, 40, 2, 3).mean(axis=(1, 3))[:, :, ::-1]
        pixels = halved.transpose(2, 0, 1)[None].astype(np.float32)
        rows.append(outputs(model, pixels)["descriptors_relu2"].reshape(-1, 4))
    cells = np.concatenate(rows).astype(np.float64)
    np.testing.assert_allclose(found.mean, cells.mean(axis=0), rtol=1e-4)
    variance = by_svd(cells, 4, 0.0)[0]
    assert found.kept == pytest.approx(variance[:2].sum() / variance.sum(), rel=1e-4)
    said = specs({"relu2": found}, reduction, images)["relu2"]
    assert (said.method, said.source_dim, said.whiten, said.kept) == ("pca", 4, 0.75, found.kept)
    assert (said.calibration, said.sha256) == (images.name, images.sha256)
