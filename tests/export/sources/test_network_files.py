"""Named networks from the files that others keep their weights in."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest

from elf_export import ExportError, WeightsError
from elf_export.sources.networks import get_network
from seeded import Tensors, seeded_weights


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


def lfnet_variables(tensors: Tensors) -> Tensors:
    """The same under a checkpoint's names, without the convolutions' biases."""
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
    return variables


def test_lfnet_from_a_checkpoint_s_variables() -> None:
    network = get_network("lfnet")
    shapes = network.tensor_shapes(network.layers)
    tensors = seeded_weights(shapes)
    variables = lfnet_variables(tensors)
    fitted = network.fit(variables, shapes)
    convs = [name for name in shapes if not name.split(".")[-2].endswith("-bn")]
    assert all((fitted[n] == (0 if n.endswith(".bias") and n in convs else tensors[n])).all() for n in shapes)
    with pytest.raises(WeightsError, match="lack block-2"):
        network.fit({k: v for k, v in variables.items() if "block-2" not in k}, shapes)


@pytest.mark.parametrize("slot", ["Adam/{}/Adam", "Adam/{}", "AdamOptimizer_1/{}", "{}/Adam_1", "{}/Momentum",
                                  "a/b/{}", "My{}", "a/My{}", "{}/ExponentialMovingAverage"])  # fmt: skip
@pytest.mark.parametrize("outer", ["", "net/"])
def test_an_optimiser_s_slots_are_not_lfnet_s_weights(slot: str, outer: str) -> None:
    network = get_network("lfnet")
    shapes = network.tensor_shapes(network.layers)
    variables = lfnet_variables(seeded_weights(shapes))
    slots = {slot.format(name): np.full_like(value, 9) for name, value in variables.items()}
    fitted = network.fit(slots | {f"{outer}{name}": value for name, value in variables.items()}, shapes)
    alone = network.fit(variables, shapes)
    assert all(np.array_equal(fitted[name], alone[name]) for name in shapes)
    with pytest.raises(WeightsError, match="lack init_conv"):
        network.fit(slots, shapes)


def test_several_variables_for_one_of_lfnet_s_are_named() -> None:
    network = get_network("lfnet")
    shapes = network.tensor_shapes(network.layers)
    variables = lfnet_variables(seeded_weights(shapes))
    twice = variables | {f"teacher/{name}": value for name, value in variables.items()}
    named = r"init_conv\.weight: ConvOnlyResNet/init_conv/weights, teacher/ConvOnlyResNet/init_conv/weights$"
    with pytest.raises(WeightsError, match=named):
        network.fit(twice, shapes)


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
