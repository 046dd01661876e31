"""The torch peer computes the saliency that the exported graph computes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elf_runtime import ElfRuntime, ModelContract

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

from elf_export.errors import WeightsError  # noqa: E402
from elf_export.saliency import build_saliency  # noqa: E402
from elf_export.sources.forward import torch_to_onnx  # noqa: E402
from elf_export.sources.networks import get_network  # noqa: E402
from elf_export.sources.torch_saliency import load  # noqa: E402

pytestmark = pytest.mark.torch


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """VGG16 up to pool1 with seeded random weights."""
    network = get_network("vgg")
    rng = np.random.default_rng(0)
    tensors = {
        name: (0.05 * rng.standard_normal(shape)).astype(np.float32)
        for name, shape in network.tensor_shapes(["pool1"]).items()
    }
    forward = torch_to_onnx(network.build(tensors, ["pool1"]), ["pool1"], 3)
    proto = build_saliency(forward, "pool1", preprocessing=network.preprocessing)
    onnx.helper.set_model_props(proto, ModelContract(network="vgg", layer="pool1", stride=2.0).to_metadata())
    onnx.save(proto, tmp_path / "vgg.onnx")
    return tmp_path / "vgg.onnx"


def test_agrees_with_the_graph(model: Path) -> None:
    image = np.random.default_rng(1).integers(0, 256, (65, 96, 3), np.uint8)
    found, wanted = load(model)(image), ElfRuntime(model).saliency(image)
    assert found.shape == wanted.shape
    # In float32 a ReLU or pooling window switches here and there; everywhere else they agree closely.
    close = np.abs(found - wanted) <= 1e-4 * wanted.max()
    assert close.mean() > 0.995


def test_weights_that_are_not_floats_are_refused(model: Path) -> None:
    proto = onnx.load(model)
    for tensor in proto.graph.initializer:
        if tensor.name == "conv1_1.weight":
            tensor.name = "conv1_1.weight_quantized"
    onnx.save(proto, model)
    with pytest.raises(WeightsError, match=r"conv1_1\.weight"):
        load(model)
