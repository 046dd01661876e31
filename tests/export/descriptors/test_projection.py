"""Shorter descriptors: the fit against an SVD, the graph against numpy, and what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime as ort
import pytest

from elf_export import (
    ExportError,
    LayerError,
    Preprocessing,
    Reduction,
    VerificationError,
    build_saliency,
    export_network,
    export_onnx,
)
from elf_export.calibration import calibration_set
from elf_export.command.main import main
from elf_export.command.options import parser, reduction_of
from elf_export.descriptors import reduce as reduce_module
from elf_export.descriptors.projection import fit, fit_layers, moments, specs, thinned
from elf_export.graph.graph import Graph
from elf_export.graph.passes import project
from elf_runtime import ElfRuntime, InputSpec
from elf_runtime.commands.info import main as info
from export.small_models import convolutions as small_convolutions
from export.small_models import model as small_model
from export.small_models import nchw, nhwc, weights
from helpers import textured


@pytest.fixture
def cells() -> np.ndarray:
    """(3000, 10) correlated, far from the origin; no two variances are close."""
    rng = np.random.default_rng(3)
    mixed = rng.standard_normal((3000, 10)) * 0.6 ** np.arange(10) @ np.linalg.qr(rng.standard_normal((10, 10)))[0]
    return mixed + rng.uniform(-20, 20, 10)


def by_svd(cells: np.ndarray, dim: int, whiten: float) -> tuple[np.ndarray, np.ndarray]:
    """Variances and whitened scores (n, dim) of the centred cells, without a covariance matrix."""
    centred = cells - cells.mean(axis=0)
    u, s, _ = np.linalg.svd(centred, full_matrices=False)
    variance = s[:dim] ** 2 / (len(cells) - 1)
    return variance, u[:, :dim] * s[:dim] * (variance / variance[0]) ** (-whiten / 2)


@pytest.mark.parametrize(("dim", "whiten"), [(1, 0.0), (4, 0.0), (4, 0.5), (10, 1.0)])
def test_pca_is_the_svd_s(cells: np.ndarray, dim: int, whiten: float) -> None:
    projection = fit(np.array_split(cells, 7), Reduction(dim, whiten=whiten))
    variance, scores = by_svd(cells, dim, whiten)
    found = projection(cells)
    signs = np.sign((found * scores).sum(axis=0))
    np.testing.assert_allclose(found, scores * signs, atol=1e-9)
    assert projection.kept == pytest.approx(variance.sum() / cells.var(axis=0, ddof=1).sum())


def test_a_component_s_largest_coefficient_is_positive(cells: np.ndarray) -> None:
    for some in (cells, -cells):
        matrix = fit([some], Reduction(10, whiten=0.0)).matrix
        assert (matrix[np.abs(matrix).argmax(axis=0), np.arange(10)] > 0).all()


def test_components_are_whitened_unless_told_otherwise(cells: np.ndarray) -> None:
    assert Reduction(4, "channels").exponent == 0.0
    found = fit([cells], Reduction(4))(cells).var(axis=0, ddof=1)
    variance = by_svd(cells, 4, 0.0)[0]
    np.testing.assert_allclose(found / found[0], (variance / variance[0]) ** 0.25)


def test_channels_are_those_that_vary_most(cells: np.ndarray) -> None:
    projection = fit([cells], Reduction(3, "channels"))
    chosen = sorted(range(10), key=lambda c: -cells[:, c].var())[:3]
    np.testing.assert_array_equal(projection(cells), cells[:, chosen])
    assert projection.kept == pytest.approx(cells[:, chosen].var(axis=0).sum() / cells.var(axis=0).sum())


def test_moments_of_batches_are_those_of_all(cells: np.ndarray) -> None:
    far = cells.astype(np.float32) + 1e4  # where a sum of squares would cancel
    mean, covariance = moments([far[:1], far[1:1], far[1:700], far[700:]])
    np.testing.assert_allclose(mean, far.astype(np.float64).mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(covariance, np.cov(far.astype(np.float64).T), rtol=1e-9, atol=1e-9)


def test_a_large_map_is_thinned_evenly() -> None:
    grid = np.stack(np.mgrid[:300, :200], axis=-1).astype(np.float32)
    rows = thinned(grid)
    np.testing.assert_array_equal(np.unique(rows[:, 0]), np.arange(0, 300, 2))
    np.testing.assert_array_equal(np.unique(rows[:, 1]), np.arange(0, 200, 2))
    assert len(thinned(grid[:100, :200])) == 20_000
    assert len(thinned(grid[:101, :200])) == 51 * 100


def test_moments_of_few_rows_are_finite(cells: np.ndarray) -> None:
    mean, covariance = moments([cells[:0], cells[:1]])
    np.testing.assert_array_equal(mean, cells[0])
    np.testing.assert_array_equal(covariance, np.zeros((10, 10)))
    again, spread = moments([cells[:0], cells[:700], cells[:0], cells[700:]])
    np.testing.assert_allclose(again, cells.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(spread, np.cov(cells.T), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"dim": 0}, "at least 1 value, not 0"),
        ({"dim": 2, "method": "lda"}, "by pca or channels, not by 'lda'"),
        ({"dim": 2, "whiten": 1.5}, r"a number in \[0, 1\], not 1.5"),
        ({"dim": 2, "whiten": -0.5}, r"a number in \[0, 1\], not -0.5"),
        ({"dim": 2, "method": "channels", "whiten": 0.5}, "goes with pca only"),
    ],
)
def test_reductions_that_make_no_sense(wanted: dict, message: str) -> None:
    with pytest.raises(LayerError, match=message):
        Reduction(**wanted)


def test_more_than_there_is(cells: np.ndarray) -> None:
    with pytest.raises(LayerError, match="it has 10 channels, fewer than the 11 asked for"):
        fit([cells], Reduction(11))
    with pytest.raises(LayerError, match="vary in 9 directions over the calibration images, fewer than the 10"):
        fit([np.c_[cells[:, :9], cells[:, :9] @ np.ones(9)]], Reduction(10))
    with pytest.raises(LayerError, match="vary in 0 directions over the calibration images, fewer than the 1"):
        fit([np.ones((10, 4), np.float32)], Reduction(1))


def test_a_direction_counts_from_a_millionth_of_the_largest_variance() -> None:
    square = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    for ratio in (1.2e-6, 0.5):
        found = fit([square * (1.0, ratio**0.5)], Reduction(2, whiten=0.0))
        np.testing.assert_allclose(np.abs(found.matrix), np.eye(2), atol=1e-12)
    with pytest.raises(LayerError, match="vary in 1 directions"):
        fit([square * (1.0, 0.8e-6**0.5)], Reduction(2, whiten=0.0))


def test_channels_may_be_asked_not_to_be_whitened() -> None:
    assert Reduction(2, "channels", whiten=0.0).exponent == 0.0


@pytest.mark.parametrize(
    "reduction",
    [Reduction(8, whiten=1 / 3), Reduction(8, whiten=0.0, separate=True), Reduction(8), Reduction(8, "channels")],
)
def test_the_options_say_the_same_reduction_to_the_last_digit(reduction: Reduction) -> None:
    found = reduction_of(parser().parse_args(["--net", "vgg", *reduction.words()]))
    assert found is not None
    assert (found.dim, found.method, found.separate) == (reduction.dim, reduction.method, reduction.separate)
    assert found.exponent == reduction.exponent


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


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    folder = tmp_path / "photographs"
    folder.mkdir()
    for seed in range(3):
        cv2.imwrite(str(folder / f"{seed}.png"), textured(60, 80, seed))
    return folder


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


def test_a_wrong_projection_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def without_mean(graph: Graph, maps: dict, separate: bool) -> Graph:
        return project(graph, {name: (matrix, 0 * bias) for name, (matrix, bias) in maps.items()}, separate)

    monkeypatch.setattr(reduce_module, "project", without_mean)
    onnx.save(nchw(("N", 3, "H", "W")), tmp_path / "net.onnx")
    with pytest.raises(VerificationError, match="projected descriptors of 'relu2' disagree"):
        export_onnx(tmp_path / "net.onnx", "pool1", ["relu2"], tmp_path / "a.onnx", reduction=Reduction(2))
    assert not (tmp_path / "a.onnx").exists()


def test_what_an_export_refuses(tmp_path: Path) -> None:
    onnx.save(nchw(("N", 3, "H", "W")), tmp_path / "net.onnx")
    for described, options, message in (
        (
            ["relu2"],
            {"reduction": Reduction(5)},
            "'relu2' can't be reduced: it has 4 channels, fewer than the 5",
        ),
        ([], {"reduction": Reduction(2)}, "there is no descriptor layer"),
        (
            ["relu2"],
            {"reduction": Reduction(2), "calibration": tmp_path / "nowhere"},
            "nowhere: not a folder",
        ),
    ):
        with pytest.raises(ExportError, match=message):
            export_onnx(tmp_path / "net.onnx", "pool1", described, tmp_path / "a.onnx", **options)
    assert not (tmp_path / "a.onnx").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--whiten", "0.5"], "--whiten goes with --desc-dim only"),
        (["--desc-reduce", "pca"], "--desc-reduce goes with --desc-dim only"),
        (["--calibration", "photos"], "--calibration goes with --compress, --desc-dim or --precision only"),
        (["--desc-dim", "0"], "--desc-dim is 1 or more, not 0"),
        (["--desc-dim", "8", "--desc", "none"], "--desc none leaves no descriptor"),
        (["--desc-dim", "8", "--whiten", "2"], "--whiten is a number from 0 to 1, not 2"),
        (
            ["--desc-dim", "8", "--whiten", "1", "--desc-reduce", "channels"],
            "goes with --desc-reduce pca only",
        ),
    ],
)
def test_options_that_do_not_go_together(capsys: pytest.CaptureFixture[str], options: list[str], message: str) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--net", "vgg", *options])
    assert stop.value.code == 2
    assert message in capsys.readouterr().err


def test_channels_that_do_not_vary_keep_nothing() -> None:
    found = fit([np.ones((10, 4), np.float32)], Reduction(2, "channels"))
    assert found.kept == 0.0
    np.testing.assert_array_equal(found.matrix, np.eye(4)[:, :2])


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


def test_a_map_that_is_not_finite_everywhere_is_refused(photographs: Path) -> None:
    """A logarithm behind a ReLU is infinite where that is 0, and finite elsewhere."""
    nodes, tensors = small_convolutions()
    nodes.append(onnx.helper.make_node("Log", ["relu2"], ["log"], name="log"))
    net = small_model(nodes, tensors, ("N", 3, "H", "W"), "log")
    model = build_saliency(net, "pool1", ["log"], "x", Preprocessing("rgb", False))
    with pytest.raises(LayerError, match="'log' gives values that are not finite; it can't be reduced"):
        fit_layers(model, ["log"], Reduction(2), calibration_set(photographs), InputSpec(color="rgb"), 1.0)
