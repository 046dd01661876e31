"""elf-export --onnx with descriptors that are another, named network's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest

from elf_export import ExportError, LayerError, Reduction, export_network, export_onnx
from elf_export.cli import main
from elf_export.graph.graph import Graph
from elf_export.graph.passes import rename_values
from elf_export.sources.networks import get_network
from elf_runtime import ElfRuntime
from export import small_models as small
from export.sources.saved_models import saved
from helpers import textured
from seeded import seeded_weights


@pytest.mark.usefixtures("small_probes")
def test_a_named_network_describes_what_anybody_s_model_finds(tmp_path: Path) -> None:
    """Its maps are those of the network alone, beside the model's own, and the command makes the file again."""
    path = saved(small.nchw(("N", 3, "H", "W")), tmp_path)
    assert main(["--onnx", str(path), "--layer", "pool1", "--desc", "vgg:pool1,relu2", "--offline", "--desc-dim", "4",
                 "-o", str(tmp_path / "elf.onnx")]) == 0  # fmt: skip
    contract = ElfRuntime(tmp_path / "elf.onnx").contract
    assert [(d.layer, d.dim, d.stride) for d in contract.descriptors] == [("vgg:pool1", 4, 2.0), ("relu2", 4, 2.0)]
    assert contract.input.color == "bgr"  # VGG's; the model's own RGB is made of it inside
    assert contract.weights.source.startswith("model.onnx; ")
    assert contract.command == (
        "elf-export --onnx model.onnx --layer pool1 --desc vgg:pool1,relu2 --desc-dim 4 --whiten 0.75 --color rgb "
        "--standardize"
    )
    result = export_onnx(path, "pool1", ["vgg:pool1", "relu2"], tmp_path / "b.onnx", offline=True)
    assert len(result.checks) == 1
    assert result.checks[0].passed
    both, image = ElfRuntime(result.path), textured(60, 80)
    alone = ElfRuntime(export_network("vgg", "pool1", ["pool1"], tmp_path / "vgg.onnx", offline=True).path)
    points = np.array([[20.0, 30.0], [41.5, 12.25]], np.float32)
    np.testing.assert_allclose(both.describe(image, points), alone.describe(image, points), atol=1e-5)
    plain = ElfRuntime(export_onnx(path, "pool1", ["relu2"], tmp_path / "c.onnx").path)
    np.testing.assert_allclose(both.saliency(image), plain.saliency(image), rtol=1e-4, atol=1e-6)
    with pytest.raises(LayerError, match=r"vgg has no layer 'pool9'"):
        export_onnx(path, "pool1", ["vgg:pool9"], tmp_path / "d.onnx")
    with pytest.raises(ExportError, match="no other network describes"):
        export_onnx(path, "pool1", ["relu2"], tmp_path / "d.onnx", desc_weights="a.pth")


def named_in_scope(scope: str) -> onnx.ModelProto:
    """Its values are called as TensorFlow does it, and as a named network's would be."""
    model = small.nchw(("N", 3, "H", "W"))
    names = {name: f"{scope}/{name}" for node in model.graph.node for name in node.output}
    names |= {tensor.name: f"{scope}/{tensor.name}" for tensor in model.graph.initializer}
    return rename_values(Graph(model), names).model


@pytest.mark.usefixtures("one_direction")
def test_another_network_s_values_have_names_of_their_own(tmp_path: Path) -> None:
    path = saved(named_in_scope("vgg"), tmp_path)
    result = export_onnx(path, "pool1", ["vgg:pool1"], tmp_path / "elf.onnx", offline=True, reduction=Reduction(4))
    names = [node.name for node in onnx.load(result.path).graph.node]
    assert len(names) == len(set(names))
    assert [spec.layer for spec in result.contract.descriptors] == ["vgg:pool1"]
    assert [type(check).__name__ for check in result.checks] == ["DifferencesCheck", "ProjectionCheck"]


def test_a_layer_of_the_model_s_own_comes_before_another_network_s(tmp_path: Path) -> None:
    model = small.nchw(("N", 3, "H", "W"))
    path = saved(rename_values(Graph(model), {"relu2": "scope/vgg:pool1"}).model, tmp_path)
    result = export_onnx(path, "pool1", ["vgg:pool1"], tmp_path / "elf.onnx", offline=True)
    assert [spec.layer for spec in result.contract.descriptors] == ["scope/vgg:pool1"]


def test_two_descriptors_of_one_output_are_refused(tmp_path: Path) -> None:
    model = small.nchw(("N", 3, "H", "W"))
    path = saved(rename_values(Graph(model), {"relu2": "vgg_pool1"}).model, tmp_path)
    with pytest.raises(LayerError, match="both be the output 'descriptors_vgg_pool1'"):
        export_onnx(path, "pool1", ["vgg_pool1", "vgg:pool1"], tmp_path / "elf.onnx", offline=True)


def alexnet_weights(folder: Path) -> Path:
    np.savez(folder / "alexnet.npz", **seeded_weights(get_network("alexnet").tensor_shapes(["pool5"])))
    return folder / "alexnet.npz"


def test_the_smallest_size_is_one_that_all_networks_take(tmp_path: Path) -> None:
    """AlexNet's pool5 of 32 pixels has windows larger than their map, at which ONNX Runtime divides by zero."""
    weights = alexnet_weights(tmp_path)
    path = saved(small.nchw(("N", 3, "H", "W")), tmp_path)
    result = export_onnx(path, "pool1", ["alexnet:pool5"], tmp_path / "elf.onnx", desc_weights=weights)
    alone = export_network("alexnet", "pool1", ["pool5"], tmp_path / "alexnet.onnx", weights=weights)
    assert result.contract.input.min_size == alone.contract.input.min_size > 32
    path = saved(small.classifier(), tmp_path)
    with pytest.raises(
        LayerError, match=r"alexnet describes images of \d+x\d+ pixels and more, and the model takes 48x40"
    ):
        export_onnx(path, "logits", ["alexnet:pool5"], tmp_path / "b.onnx", desc_weights=weights)
