"""Every named network: its architecture, its graph against autograd, its geometry, its weights."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
import torch

from elf_eval.methods.gradient import gradient_saliency
from elf_export import ExportError, WeightsError, export_network
from elf_export.checks.pictures import preprocess
from elf_export.checks.torch_reference import torch_saliency
from elf_export.graph.receptive_field import receptive_fields
from elf_export.saliency import build_saliency
from elf_export.sources.forward import NETWORK_INPUT, torch_to_onnx
from elf_export.sources.networks import Network, get_network, network_names
from elf_export.sources.weights.load import load_weights
from elf_runtime import ElfRuntime, preset
from elf_runtime.model.session import open_session
from helpers import ROOT, shared, textured
from network_row import network_rows
from seeded import Tensors, evaluator64, seeded_weights

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


@pytest.mark.parametrize(("name", "layer"), LAYERS)
def test_the_same_graph_in_float64_is_exact(name: str, layer: str) -> None:
    network = get_network(name)
    settings = network.preprocessing
    module = built(network, [layer])
    forward = torch_to_onnx(module, [layer], settings.channels)
    model = build_saliency(forward, layer, [], NETWORK_INPUT, settings, differentiate=network.gradient)
    evaluator = evaluator64(model)
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


# -- two networks ------------------------------------------------------------------------------------------


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


# -- files -------------------------------------------------------------------------------------------------


def keras2(tensors: Tensors) -> Tensors:
    """As Keras 2 writes Xception's .h5: layers inside themselves, shortcuts numbered from 1."""
    named: Tensors = {}
    roles = {
        "weight": "gamma",
        "bias": "beta",
        "running_mean": "moving_mean",
        "running_var": "moving_variance",
    }
    for name, value in tensors.items():
        layer, _, role = name.partition(".")
        if "residual" in layer:
            number = int(layer[5]) - 1
            layer = f"{'batch_normalization' if layer.endswith('_bn') else 'conv2d'}_{number}"
        if value.ndim == 1:
            key = roles[role]
        else:
            key = f"{role.partition('.')[0]}_kernel" if "." in role else "kernel"
            value = value.transpose(2, 3, 0, 1) if "depthwise" in role else value.transpose(2, 3, 1, 0)
        named[f"{layer}/{layer}/{key}:0"] = value
    return dict(sorted(named.items()))


def keras3(tensors: Tensors) -> Tensors:
    """As Keras 3 archives a frozen base: every kind numbered in the order of creation."""
    numbered: Tensors = {}
    counts: dict[str, list[str]] = {"conv2d": [], "separable_conv2d": [], "batch_normalization": []}
    order = ("weight", "bias", "running_mean", "running_var")
    for name, value in tensors.items():
        layer, _, role = name.partition(".")
        kind = "batch_normalization" if value.ndim == 1 else "separable_conv2d" if "sep" in layer else "conv2d"
        if layer not in counts[kind]:
            counts[kind].append(layer)
        number = counts[kind].index(layer)
        index = order.index(role) if value.ndim == 1 else int(role.startswith("pointwise"))
        if value.ndim == 4:
            value = value.transpose(2, 3, 0, 1) if "depthwise" in role else value.transpose(2, 3, 1, 0)
        numbered[f"layers/base/layers/{kind}{f'_{number}' if number else ''}/vars/{index}"] = value
    return numbered | {"optimizer/vars/2": np.zeros((2048, 100), np.float32)}


@pytest.mark.parametrize("write", [dict, keras2, keras3])
def test_xception_from_every_generation_of_keras(write: Callable[[Tensors], Tensors]) -> None:
    network = get_network("xception")
    shapes = network.tensor_shapes(network.layers)
    tensors = seeded_weights(shapes)
    fitted = network.fit(write(tensors), shapes)
    assert fitted.keys() == tensors.keys()
    assert all((fitted[name] == tensors[name]).all() for name in tensors)


def test_lfnet_from_a_checkpoint_s_variables() -> None:
    network = get_network("lfnet")
    shapes = network.tensor_shapes(network.layers)
    tensors = seeded_weights(shapes)
    roles = {
        "weight": "gamma",
        "bias": "beta",
        "running_mean": "moving_mean",
        "running_var": "moving_variance",
    }
    variables: Tensors = {}
    for name, value in tensors.items():
        part, role = name.rsplit(".", 1)
        scope = f"ConvOnlyResNet/{part.replace('.', '/')}"
        if part.endswith("-bn"):
            variables[f"{scope}/{roles[role]}"] = value
        elif value.ndim == 4:
            variables[f"{scope}/weights"] = value.transpose(2, 3, 1, 0)
    fitted = network.fit(variables, shapes)
    convs = [name for name in shapes if not name.split(".")[-2].endswith("-bn")]
    assert all((fitted[n] == (0 if n.endswith(".bias") and n in convs else tensors[n])).all() for n in shapes)
    with pytest.raises(WeightsError, match="lack block-2"):
        network.fit({k: v for k, v in variables.items() if "block-2" not in k}, shapes)


@pytest.mark.parametrize("prefix", ["", "backbone."])
def test_state_dicts_under_a_prefix(prefix: str) -> None:
    network = get_network("resnet18")
    shapes = network.tensor_shapes(["layer1.1"])
    tensors = seeded_weights(network.tensor_shapes(network.layers))
    fitted = network.fit({prefix + name: value for name, value in tensors.items()}, shapes)
    assert all((fitted[name] == tensors[name]).all() for name in shapes)


def test_squeezenet_under_torchvision_s_names_takes_rgb() -> None:
    network = get_network("squeezenet")
    shapes = network.tensor_shapes(["fire9"])
    tensors = seeded_weights(shapes)
    modules = {
        "fire2": 3,
        "fire3": 4,
        "fire4": 6,
        "fire5": 7,
        "fire6": 9,
        "fire7": 10,
        "fire8": 11,
        "fire9": 12,
    }
    state = {}
    for name, value in tensors.items():
        head, _, rest = name.partition(".")
        index = 0 if head == "conv1" else modules[head]
        state[f"features.{index}.{rest.replace('squeeze1x1', 'squeeze')}"] = value
    fitted = network.fit(state, shapes)
    assert (fitted["conv1.weight"] == tensors["conv1.weight"][:, ::-1]).all()
    assert all((fitted[n] == tensors[n]).all() for n in shapes if n != "conv1.weight")


def test_without_pytorch_only_pytorch_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "elf_export.sources.networks.resnet18", raising=False)
    with pytest.raises(ExportError, match=r"^--net resnet18 is built with PyTorch: pip install torch \(the CPU build"):
        get_network("resnet18")
