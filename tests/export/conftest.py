"""One exported VGG16, made from the weights in the bundled model, for all tests here."""

from __future__ import annotations

import pytest

from elf_export.checks import autograd, directional, trial
from elf_export.saliency import build_saliency
from elf_export.sources.forward import NETWORK_INPUT, torch_to_onnx
from elf_export.sources.networks import get_network
from elf_export.sources.sizes import free
from elf_export.sources.weights.load import load_weights
from export.exported import Exported


@pytest.fixture(scope="session")
def vgg() -> Exported:
    network = get_network("vgg")
    weights = load_weights(network, ["pool2"], offline=True)
    module = network.build(weights.tensors, ["pool2"])
    forward = torch_to_onnx(module, ["pool2"], 3)
    return Exported(module, forward, build_saliency(forward, "pool2", [], NETWORK_INPUT, network.preprocessing))


@pytest.fixture
def small_probes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The exporter verifies on 128x96 and 127x97 pixels, a third of its own: float64 convolutions take their time.

    It tries the finished graph on no image as long as 2048 pixels, and the file on two images instead of three.

    Every bound stays. What tests do without this fixture keeps the exporter's sizes covered.
    """
    monkeypatch.setattr(autograd, "SIZES", ((96, 128), (97, 127)))
    monkeypatch.setattr(free, "LONG", 256)
    monkeypatch.setattr(trial, "AT", trial.AT[:1])


@pytest.fixture
def one_direction(monkeypatch: pytest.MonkeyPatch) -> None:
    """The exporter takes one direction of each family on each image, not three: a third of the forward passes.

    A wrong factor or place shows along any of them. Every bound stays.
    """
    monkeypatch.setattr(directional, "DIRECTIONS", 1)
