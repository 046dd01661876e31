"""A named network as a source: its layers and trained weights, built in torch, and torch.autograd for its oracle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from elf_export.checks.autograd import Autograd
from elf_export.detection import changed, chosen
from elf_export.errors import ExportError
from elf_export.file import check_output, default_name
from elf_export.graph.image_input import ImageInput
from elf_export.graph.passes import opset_of
from elf_export.graph.receptive_field import receptive_fields
from elf_export.graph.sizes import Sizes
from elf_export.preprocessing import Preprocessing
from elf_export.request import Log, Request, check_precision
from elf_runtime import DetectionParams, WeightsSpec

from .describing import check_others
from .forward import DEFAULT_OPSET, NETWORK_INPUT, torch_to_onnx
from .networks import Network, get_network
from .sizes.free import LEAST
from .source import Source
from .weights.load import load_weights, needs_naming

if TYPE_CHECKING:
    import torch


def named_detector(request: Request, log: Log) -> Source:
    """The network that `request.net` names, as a detector.

    Raises
    ------
    ExportError
        Unknown network or layer, an output that can't be written, missing weights.
    """
    network = get_network(request.net or "")
    detection = chosen(network.detection, request.detection)
    layer = request.layer or network.default_layer
    described = network.default_descriptors if request.desc is None else request.desc
    labels = list(dict.fromkeys(word.removeprefix(f"{network.name}:") for word in described))
    own = [label for label in labels if ":" not in label]
    network.check_layers([layer, *own])
    check_others(request, [label for label in labels if label not in own])
    opset = request.opset or DEFAULT_OPSET
    check_precision(request.precision, opset)
    preprocessing = _preprocessing(network, request)
    complete = replace(
        request,
        layer=layer,
        desc=tuple(labels),
        output=check_output(request.output or default_name(network.name, layer), request.force),
        detection=changed(network.detection, detection),
        opset=opset if opset != DEFAULT_OPSET else None,
    )
    return _source(complete, network, layer, own, preprocessing, detection, opset, log)


def describer(name: str, layers: Sequence[str], detector: Source, log: Log) -> Source:
    """Another named network, whose `layers` describe what `detector` finds."""
    network = get_network(name)
    request = Request(net=name, weights=detector.request.desc_weights, offline=detector.request.offline)
    source = _source(
        request, network, layers[0], layers, network.preprocessing, network.detection, opset_of(detector.model), log,
        option="--desc-weights",
    )  # fmt: skip
    return replace(source, scope=f"{name}:")


def _preprocessing(network: Network, request: Request) -> Preprocessing:
    if isinstance(request.preprocess, Preprocessing):
        return request.preprocess
    if request.preprocess in (None, "paper"):
        return network.preprocessing
    if request.preprocess != "own":
        raise ExportError(f"preprocessing is 'paper', 'own' or a Preprocessing, not {request.preprocess!r}")
    if network.trained_with is None:
        raise ExportError(f"what {network.name} was trained with is not known; --preprocess paper standardises")
    return network.trained_with


def _source(
    request: Request,
    network: Network,
    layer: str,
    descriptors: Sequence[str],
    preprocessing: Preprocessing,
    detection: DetectionParams,
    opset: int,
    log: Log,
    option: str = "--weights",
) -> Source:
    layers = list(dict.fromkeys([layer, *descriptors]))
    loaded = load_weights(network, layers, request.weights, request.offline, log, option)
    module = network.build(loaded.tensors, layers)
    channels = preprocessing.channels
    forward = torch_to_onnx(module, layers, channels, opset)
    return Source(
        request=replace(request, weights=request.weights if needs_naming(network, layers, loaded) else None),
        name=network.name,
        model=forward,
        image=ImageInput(NETWORK_INPUT, "NCHW", channels, (None, None, None)),
        layer=layer,
        descriptors=tuple(descriptors),
        preprocessing=preprocessing,
        fields=receptive_fields(forward, NETWORK_INPUT),
        sizes=Sizes(min_size=least_size(module, channels)),
        period=1.0,  # it pools and convolves in floor mode: what it does at one size it does at the next
        weights=WeightsSpec(loaded.source, loaded.sha256, loaded.licence),
        oracle=Autograd(module, tuple(layers), preprocessing, network.gradient),
        detection=detection,
        differentiate=network.gradient,
    )


def least_size(module: torch.nn.Module, channels: int) -> int:
    """The smallest square image, of LEAST, on which none of the module's maps is empty."""
    import torch

    for pixels in LEAST[:-1]:
        try:
            maps = module(torch.zeros(1, channels, pixels, pixels))
        except RuntimeError:  # a window that is larger than its map
            continue
        if all(min(value.shape) > 0 for value in maps):
            return pixels
    return LEAST[-1]
