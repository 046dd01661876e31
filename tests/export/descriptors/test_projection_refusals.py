"""Shorter descriptors that are refused, and projections that are not written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest

from elf_export import ExportError, LayerError, Preprocessing, Reduction, VerificationError, build_saliency, export_onnx
from elf_export.calibration import calibration_set
from elf_export.cli import main
from elf_export.descriptors import reduce as reduce_module
from elf_export.descriptors.projection import fit, fit_layers
from elf_export.graph.graph import Graph
from elf_export.graph.passes import project
from elf_runtime import InputSpec
from export.small_models import convolutions as small_convolutions
from export.small_models import model as small_model
from export.small_models import nchw


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


def test_a_map_that_is_not_finite_everywhere_is_refused(photographs: Path) -> None:
    """A logarithm behind a ReLU is infinite where that is 0, and finite elsewhere."""
    nodes, tensors = small_convolutions()
    nodes.append(onnx.helper.make_node("Log", ["relu2"], ["log"], name="log"))
    net = small_model(nodes, tensors, ("N", 3, "H", "W"), "log")
    model = build_saliency(net, "pool1", ["log"], "x", Preprocessing("rgb", False))
    with pytest.raises(LayerError, match="'log' gives values that are not finite; it can't be reduced"):
        fit_layers(model, ["log"], Reduction(2), calibration_set(photographs), InputSpec(color="rgb"), 1.0)
