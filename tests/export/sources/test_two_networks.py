"""One named network finds, another describes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnx

from elf_export import export_network
from elf_export.sources.networks import get_network
from elf_runtime import ElfRuntime
from helpers import textured
from seeded import seeded_weights


def test_another_network_describes(tmp_path: Path) -> None:
    """Grey SuperPoint finds, colour VGG describes: the same descriptors as VGG's own file gives."""
    network = get_network("superpoint")
    weights = tmp_path / "seeded.npz"
    np.savez(weights, **seeded_weights(network.tensor_shapes(["desc"])))
    descriptors = ["vgg:relu3_2", "superpoint:desc", "vgg:pool1"]
    both = export_network("superpoint", None, descriptors, tmp_path / "both.onnx", weights=weights, offline=True)
    assert [d.layer for d in both.contract.descriptors] == ["vgg:relu3_2", "desc", "vgg:pool1"]
    assert [(d.dim, d.stride, d.offset) for d in both.contract.descriptors] == [
        (256, 4.0, 1.5), (256, 8.0, 3.5), (64, 2.0, 0.5)
    ]  # fmt: skip
    assert "Oxford" in both.contract.weights.source
    assert both.contract.command.endswith("--desc vgg:relu3_2,desc,vgg:pool1")
    alone = export_network("vgg", "pool1", ["relu3_2"], tmp_path / "vgg.onnx", offline=True)
    image, points = textured(96, 128), np.array([[20.0, 30.0], [64.5, 70.25], [100.0, 12.0]], np.float32)
    one = ElfRuntime(both.path).describe(image, points)
    other = ElfRuntime(alone.path).describe(image, points)
    np.testing.assert_allclose(one, other, atol=1e-6)

    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    single = export_network("superpoint", None, [], tmp_path / "grey.onnx", weights=weights)
    assert single.contract.input.color == "gray"
    # The grey image of 8-bit pixels is rounded to 8 bits, the one inside the graph is not.
    apart = np.abs(ElfRuntime(single.path).saliency(grey) - ElfRuntime(both.path).saliency(image))
    assert apart.max() <= 0.03 * ElfRuntime(single.path).saliency(grey).max()


def test_what_two_networks_have_in_common_is_computed_once(tmp_path: Path) -> None:
    network = get_network("alexnet")
    weights = tmp_path / "seeded.npz"
    np.savez(weights, **seeded_weights(network.tensor_shapes(["pool1"])))
    result = export_network("alexnet", "pool1", ["vgg:pool1"], tmp_path / "a.onnx", weights=weights, offline=True)
    nodes = [node.name for node in onnx.load(result.path).graph.node]
    assert sum("pre/" in name for name in nodes) == sum(name.startswith("pre/") for name in nodes)
    same = export_network("vgg", "pool1", ["vgg:pool2", "pool1"], tmp_path / "b.onnx", offline=True)
    assert [d.layer for d in same.contract.descriptors] == ["pool2", "pool1"]
    assert not any("vgg/" in node.name for node in onnx.load(same.path).graph.node)
