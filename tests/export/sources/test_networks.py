"""Every named network: its architecture, its graph against autograd, its geometry, its trained weights."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
import torch

from elf_eval.methods.gradient import gradient_saliency
from elf_export import ExportError, export_network
from elf_export.checks.pictures import preprocess
from elf_export.checks.torch_reference import torch_saliency
from elf_export.graph.receptive_field import receptive_fields
from elf_export.lowering import TARGETS
from elf_export.saliency import build_saliency
from elf_export.sources.forward import NETWORK_INPUT, torch_to_onnx
from elf_export.sources.networks import Network, get_network, network_names
from elf_export.sources.weights.load import load_weights
from elf_runtime import ElfRuntime, preset
from elf_runtime.model.session import open_session
from export.adjoint.stand_ins import ConvTranspose
from helpers import ROOT, shared, textured
from network_row import network_rows
from seeded import evaluator64, seeded_weights

NAMES = [name for name in network_names() if name != "vgg"]  # VGG has its own tests, with real weights
ROWS = network_rows()


def built(network: Network, layers: list[str], seed: int = 0) -> torch.nn.Module:
    return network.build(seeded_weights(network.tensor_shapes(layers), seed), layers)


def own_descriptors(network: Network) -> list[str]:
    return [layer for layer in network.default_descriptors if ":" not in layer]


# -- architecture ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if row.parameters])
def test_parameter_counts_are_the_published_ones(name: str) -> None:
    network = get_network(name)
    shapes = network.tensor_shapes(network.layers)
    trained = [np.prod(shape) for name, shape in shapes.items() if ".running_" not in name]
    assert sum(trained) == ROWS[name].parameters


@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if row.maps])
def test_maps_have_the_published_sizes(name: str) -> None:
    network, maps, size = get_network(name), ROWS[name].maps, ROWS[name].input_size
    module = built(network, list(maps)).to("meta")  # shapes without numbers
    found = module(torch.zeros(1, network.preprocessing.channels, size, size, device="meta"))
    assert {layer: tuple(f.shape[1:]) for layer, f in zip(maps, found, strict=True)} == maps


def test_every_network_has_its_row_and_is_called_as_its_file() -> None:
    assert list(ROWS) == NAMES
    assert [get_network(name).name for name in network_names()] == network_names()


@pytest.mark.parametrize("name", NAMES)
def test_layers_are_unique_and_ask_for_more_tensors_the_deeper_they_are(name: str) -> None:
    network = get_network(name)
    assert len(set(network.layers)) == len(network.layers)
    network.check_layers([network.default_layer, *own_descriptors(network)])
    counts = [len(network.tensor_shapes([layer])) for layer in network.layers]
    assert counts == sorted(counts)
    assert network.licence or not counts[-1]


# -- the graph ---------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("small_probes")
@pytest.mark.parametrize("name", NAMES)
def test_the_exported_file_agrees_with_autograd(tmp_path: Path, name: str) -> None:
    """At the paper's layers, odd sizes and a batch included: the exporter's own verification."""
    network = get_network(name)
    layers = [network.default_layer, *own_descriptors(network)]
    weights, shapes = tmp_path / "seeded.npz", network.tensor_shapes(layers)
    np.savez(weights, **seeded_weights(shapes))
    result = export_network(
        name, None, own_descriptors(network), tmp_path / "a.onnx", weights=weights if shapes else None
    )
    assert all(check.passed for check in result.checks)
    model = onnx.load(result.path)
    assert {node.domain for node in model.graph.node} == {""}
    elf = ElfRuntime(result.path)
    assert elf.contract.detection == preset("paper", name).updated(quantize=False, min_contrast=1.5)
    image = textured(96, 128)
    found = elf.detect(image, border=4)
    assert found.descriptors.shape[0] == len(found) > 0


# The networks of the paper at the other layers that it speaks of, too.
LAYERS = [(name, layer) for name in NAMES for layer in (get_network(name).default_layer, *ROWS[name].other_layers)]


@pytest.mark.parametrize("lowering", TARGETS)
@pytest.mark.parametrize(("name", "layer"), LAYERS)
def test_the_same_graph_in_float64_is_exact(name: str, layer: str, lowering: str) -> None:
    network = get_network(name)
    settings = network.preprocessing
    module = built(network, [layer])
    forward = torch_to_onnx(module, [layer], settings.channels)
    model = build_saliency(
        forward, layer, [], NETWORK_INPUT, settings, differentiate=network.gradient, lowering=lowering
    )
    evaluator = evaluator64(model, ConvTranspose)  # onnx's own takes no groups
    reference = torch_saliency(module, settings, differentiate=network.gradient)
    for height, width in ((49, 52), (50, 51)):
        images = [textured(height, width, seed, settings.channels) for seed in range(2)]
        images[1][: height // 2] = 77  # ties
        pixels = np.stack(images).astype(np.float64)
        (found,) = evaluator.run(["saliency"], {"image": pixels})
        wanted = reference(pixels)
        assert found.shape == wanted.shape
        # Weights are rounded to float32 once more where the graph folds a normalisation into a convolution.
        assert np.abs(found - wanted).max() <= 2e-6 * wanted.max()


@pytest.mark.parametrize("kind", ["sobel", "laplacian"])
def test_image_gradients_are_opencv_s(kind: str) -> None:
    network = get_network(kind)
    forward = torch_to_onnx(built(network, ["magnitude"]), ["magnitude"], 3)
    model = build_saliency(forward, "magnitude", [], NETWORK_INPUT, network.preprocessing, differentiate=False)
    session, _ = open_session(model.SerializeToString())
    image = textured(61, 83)
    found = session.run(["saliency"], {"image": image[None].astype(np.float32)})[0][0]
    wanted = gradient_saliency(cv2.cvtColor(image.astype(np.float32), cv2.COLOR_BGR2GRAY), kind)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * wanted.max())


# -- geometry ----------------------------------------------------------------------------------------------


GEOMETRIES = [(name, *where) for name, row in ROWS.items() for where in row.geometry]


@pytest.mark.parametrize(("name", "layer", "size"), GEOMETRIES)
def test_stride_and_offset_are_where_a_cell_looks(name: str, layer: str, size: tuple[int, int]) -> None:
    """The pixels that move one cell, over images on which different pool entries win, are centred on it."""
    network = get_network(name)
    weights = {k: np.abs(v) for k, v in seeded_weights(network.tensor_shapes([layer])).items()}
    weights = {k: v / v.sum((1, 2, 3), keepdims=True) if v.ndim == 4 else v for k, v in weights.items()}
    module = network.build(weights, [layer])
    forward = torch_to_onnx(module.float(), [layer], network.preprocessing.channels)
    field = receptive_fields(forward, NETWORK_INPUT, size)[layer]
    module = module.double()
    seen = np.zeros(size, bool)
    for seed in range(24):
        noise = np.random.default_rng(seed).uniform(0.1, 1.0, (1, network.preprocessing.channels, *size))
        x = torch.from_numpy(noise).requires_grad_(True)
        feature = module(x)[0]
        row, column = feature.shape[2] // 2, feature.shape[3] // 2
        (gradient,) = torch.autograd.grad(feature[0, :, row, column].sum(), x)
        seen |= (gradient.abs().amax((0, 1)) > 0).numpy()
    columns = np.flatnonzero(seen.any(0))
    assert columns[0] > 0
    assert columns[-1] < size[1] - 1
    middle = field.offset + column * field.stride
    reach = (columns[-1] - columns[0] + 1) / 2
    assert abs((columns[0] + columns[-1]) / 2 - middle) <= max(0.5, 0.06 * reach)
    assert columns[-1] - columns[0] + 1 <= field.size


# -- real weights ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if row.weights])
def test_real_weights_are_recognised_and_agree_with_autograd(tmp_path: Path, name: str) -> None:
    file = shared("weights", str(ROWS[name].weights))
    network = get_network(name)
    result = export_network(name, None, own_descriptors(network), tmp_path / "a.onnx", weights=file)
    assert all(check.passed for check in result.checks)
    weights = result.contract.weights
    assert (weights.source, weights.licence) == (network.source_title, network.licence)
    assert "non-commercial" in weights.licence or name != "superpoint"
    everything = load_weights(network, network.layers, file)
    assert everything.source == network.source_title

    image = cv2.resize(cv2.imread(str(ROOT / "demo" / "palace.jpg")), (320, 240), interpolation=cv2.INTER_AREA)
    elf = ElfRuntime(result.path)
    assert len(elf.detect(image, threshold="none")) >= 50


def test_the_reference_converts_colours_as_opencv_does() -> None:
    image = textured(20, 30).astype(np.float32)
    grey = get_network("superpoint").trained_with
    assert grey is not None
    wanted = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) / 255
    np.testing.assert_allclose(preprocess(image[None], grey, "bgr")[0, 0], wanted, atol=1e-6)


def test_preprocessing_of_the_training(tmp_path: Path) -> None:
    network = get_network("superpoint")
    np.savez(tmp_path / "w.npz", **seeded_weights(network.tensor_shapes(["conv1a"])))
    result = export_network(
        "superpoint", None, [], tmp_path / "a.onnx", weights=tmp_path / "w.npz", preprocessing="own"
    )
    assert "0.00392157" in result.contract.preprocessing
    assert result.contract.command.endswith("--preprocess own")
    with pytest.raises(ExportError, match="what sobel was trained with is not known"):
        export_network("sobel", None, [], tmp_path / "b.onnx", preprocessing="own")
