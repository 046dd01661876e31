"""From a named network to a verified .onnx file with its contract."""

from __future__ import annotations

import copy
import os
import shlex
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from elf_runtime import InputSpec, ModelContract, WeightsSpec
from elf_runtime.contract import ReductionSpec

from .calibration import calibration_set
from .checks import autograd as verify
from .checks.projection import MapCheck
from .checks.projection import parity as map_parity
from .descriptors.other_network import attach, by_network, label
from .descriptors.projection import Reduction
from .descriptors.reduce import arguments as reduction_arguments
from .descriptors.reduce import reduce_descriptors
from .detection import Wanted, chosen
from .detection import arguments as detection_arguments
from .errors import ExportError
from .graph.receptive_field import receptive_fields, stated
from .output import ExportResult, check_opset, check_output, cost_of, descriptor_specs, first_that_runs, versions, write
from .precision.lower import check_precision, lower
from .preprocessing import Preprocessing
from .saliency import build_saliency
from .sources.forward import DEFAULT_OPSET, NETWORK_INPUT, torch_to_onnx
from .sources.networks import get_network
from .sources.weights.load import Weights, load_weights
from .sources.weights.load import arguments as weights_arguments

if TYPE_CHECKING:
    import torch

SIZES = (32, 48, 64, 96, 128, 160)


def export_network(
    name: str,
    layer: str | None = None,
    descriptors: Sequence[str] | None = None,
    output: str | os.PathLike[str] | None = None,
    *,
    weights: str | os.PathLike[str] | None = None,
    opset: int = DEFAULT_OPSET,
    force: bool = False,
    offline: bool = False,
    detection: Wanted = None,
    preprocessing: Preprocessing | Literal["paper", "own"] = "paper",
    desc_weights: str | os.PathLike[str] | None = None,
    reduction: Reduction | None = None,
    calibration: str | os.PathLike[str] | None = None,
    precision: str = "fp32",
    log: Callable[[str], None] = lambda _: None,
) -> ExportResult:
    """Export a named network as an ELF model.

    Parameters
    ----------
    name : str
        As in ``elf_export.sources.networks.network_names()``.
    layer, descriptors : optional
        The paper's by default; an empty sequence makes a detector without descriptors.  ``vgg:pool3`` describes
        by a layer of another network, which comes into the same file.
    output : path, optional
        ``elf-NAME-LAYER.onnx`` by default.
    weights : path, optional
        See `elf_export.sources.weights.load.load_weights`.
    force : bool
        Overwrite an existing file.
    detection : DetectionParams or dict, optional
        The settings that the runtime uses where the caller gives none, or what to change of the network's own.
    preprocessing : "paper", "own" or Preprocessing
        For the detector: the paper's standardisation, what the network was trained with, or any other.
    desc_weights : path, optional
        Weights of the other network that describes, as `weights`.
    reduction : Reduction, optional
        Fewer values a descriptor, in every descriptor layer; the layers' channels as they are by default.
    calibration : path, optional
        Folder of images that reduction and precision are fitted to; the exporter's photographs by default.
    precision : "fp32", "fp16", "bf16" or "int8"
        See `elf_export.precision.lower.lower`.

    Returns
    -------
    ExportResult

    Raises
    ------
    ExportError
        Unknown network, layer or opset, missing weights, an existing file, a calibration image that can't be
        used, or a graph that does not agree with torch.autograd; no file is left behind.
    """
    network = get_network(name)
    params = chosen(network.detection, detection)
    layer = layer or network.default_layer
    wanted = list(dict.fromkeys(network.default_descriptors if descriptors is None else descriptors))
    described = by_network(name, wanted)
    own, others = described.pop(name), {other: get_network(other) for other in described}
    network.check_layers([layer, *own])
    for other, its_layers in described.items():
        others[other].check_layers(its_layers)
    if desc_weights is not None and not others:
        raise ExportError(f"--desc-weights {desc_weights}: no other network describes (--desc NET:LAYER)")
    path = check_output(output or f"elf-{name}-{layer}.onnx", force)
    check_opset(opset)
    check_precision(precision, opset)
    images = calibration_set(calibration)

    settings = network.preprocessing
    if preprocessing == "own" and network.trained_with is None:
        raise ExportError(f"what {name} was trained with is not known; --preprocess paper standardises")
    if preprocessing == "own" and network.trained_with is not None:
        settings = network.trained_with
    elif isinstance(preprocessing, Preprocessing):
        settings = preprocessing
    colors = {settings.color, *(other.preprocessing.color for other in others.values())}
    color = settings.color if len(colors) == 1 else "bgr"
    layers = list(dict.fromkeys([layer, *own]))
    loaded = load_weights(network, layers, weights, offline, log)
    module = network.build(loaded.tensors, layers)
    forward = torch_to_onnx(module, layers, settings.channels, opset)
    smallest, provenance = least_size(module, settings.channels), [loaded]
    model = build_saliency(
        forward, layer, own, NETWORK_INPUT, settings, differentiate=network.gradient, color=color,
        channels_last=precision == "int8", min_size=smallest,
    )  # fmt: skip
    fields = receptive_fields(forward, NETWORK_INPUT)
    references = {name: (module, layers, settings)}
    weights_words = weights_arguments("--weights", network, layers, weights, loaded)
    for other, its_layers in described.items():
        other_network = others[other]
        its_weights = load_weights(other_network, its_layers, desc_weights, offline, log, "--desc-weights")
        its_module = other_network.build(its_weights.tensors, its_layers)
        its_forward = torch_to_onnx(its_module, its_layers, other_network.preprocessing.channels, opset)
        model = attach(model, its_forward, other, its_layers, other_network.preprocessing, color)
        references[other] = (its_module, its_layers, other_network.preprocessing)
        its_fields = receptive_fields(its_forward, NETWORK_INPUT)
        fields |= {label(other, its_layer, name): its_fields[its_layer] for its_layer in its_layers}
        smallest = max(smallest, least_size(its_module, other_network.preprocessing.channels))
        provenance.append(its_weights)
        weights_words += weights_arguments("--desc-weights", other_network, its_layers, desc_weights, its_weights)

    from .checks.reference import torch_maps, torch_saliency

    def reference(dtype: str) -> verify.Reference:
        return torch_saliency(copy.deepcopy(module), settings, dtype, network.gradient, color)

    def maps(pixels: verify.Array) -> dict[str, NDArray[np.floating]]:
        found: dict[str, NDArray[np.floating]] = {}
        for other, (its_module, its_layers, its_settings) in references.items():
            own_maps = torch_maps(copy.deepcopy(its_module), its_layers, its_settings, color)(pixels)
            found |= {label(other, its_layer, name): value for its_layer, value in own_maps.items()}
        return found

    channels = 1 if color == "gray" else 3
    smallest = first_that_runs(model, {size: (1, size, size, channels) for size in SIZES if size >= smallest})
    labels = [f"{other}:{its}" for other in described for its in described[other]]
    # In the order that was asked for: the first describes by default.
    labels = sorted([*own, *labels], key=[w.removeprefix(f"{name}:") for w in wanted].index)
    spec = InputSpec(color=color, channels=channels, min_size=smallest)
    reductions: dict[str, ReductionSpec] = {}
    map_checks: list[MapCheck] = []
    if reduction is not None:
        model, reductions, map_checks = reduce_descriptors(
            model, labels, reduction, images, spec, params.scale, maps, log
        )
    checks = verify.verify(model, reference("float64"), channels, params, reference("float32"))
    verify.require(checks)
    log(verify.table(checks))

    arguments = ["elf-export", "--net", name, *weights_words]
    arguments += ["--opset", str(opset)] if opset != DEFAULT_OPSET else []
    arguments += ["--layer", layer, "--desc", ",".join(labels) or "none"]
    if preprocessing == "own":
        arguments += ["--preprocess", "own"]
    arguments += reduction_arguments(reduction)
    arguments += detection_arguments(network.detection, params)
    arguments += ["--precision", precision] if precision != "fp32" else []
    arguments += ["--calibration", os.fspath(calibration)] if calibration is not None else []
    contract = ModelContract(
        network=name,
        layer=layer,
        stride=fields[layer].stride,
        receptive_field=stated(fields[layer].size),
        input=spec,
        descriptors=descriptor_specs(model, labels, fields, reductions),
        detection=params,
        preprocessing=settings.describe(),
        weights=joined(provenance),
        parity=verify.parity(checks) | map_parity(map_checks),
        cost=cost_of(model, labels),
        versions=versions(opset),
        command=shlex.join(arguments),
    )
    model, contract = lower(model, contract, precision, images, log)
    write(model, contract, path)
    return ExportResult(path, contract, checks)


def joined(parts: Sequence[Weights]) -> WeightsSpec:
    """Where the weights of all networks in a file come from; those that need none are left out."""
    trained = [part for part in parts if part.tensors] or list(parts[:1])
    return WeightsSpec(
        "; ".join(part.source for part in trained),
        "; ".join(part.sha256 for part in trained),
        "; ".join(part.licence for part in trained),
    )


def least_size(module: torch.nn.Module, channels: int) -> int:
    """The smallest square image, of SIZES, on which none of the module's maps is empty."""
    import torch

    for pixels in SIZES[:-1]:
        try:
            maps = module(torch.zeros(1, channels, pixels, pixels))
        except RuntimeError:  # a window that is larger than its map
            continue
        if all(min(value.shape) > 0 for value in maps):
            return pixels
    return SIZES[-1]
