"""One exported VGG16, made from the weights in the bundled model, for all tests here."""

from __future__ import annotations

from dataclasses import dataclass

import onnx
import pytest
import torch

from elf_export.forward import NETWORK_INPUT, torch_to_onnx
from elf_export.networks import get_network
from elf_export.saliency import build_saliency
from elf_export.weights.load import load_weights


@dataclass(frozen=True)
class Exported:
    """The paper's detector: VGG16's pool2."""

    module: torch.nn.Module
    forward: onnx.ModelProto
    model: onnx.ModelProto


@pytest.fixture(scope="session")
def vgg() -> Exported:
    network = get_network("vgg")
    weights = load_weights(network, ["pool2"], offline=True)
    module = network.build(weights.tensors, ["pool2"])
    forward = torch_to_onnx(module, ["pool2"], 3)
    return Exported(module, forward, build_saliency(forward, "pool2", [], NETWORK_INPUT, network.preprocessing))
