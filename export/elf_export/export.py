"""From a named network to a verified .onnx file with its contract."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Sequence

from elf_runtime import DetectionParams, InputSpec, ModelContract, WeightsSpec

from . import verify
from .forward import DEFAULT_OPSET, NETWORK_INPUT, torch_to_onnx
from .graph import Graph
from .networks import get_network
from .output import ExportResult, check_opset, check_output, cost_of, descriptor_specs, versions, write
from .receptive_field import receptive_fields
from .saliency import build_saliency
from .weights.load import load_weights


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
    detection: DetectionParams | None = None,
    log: Callable[[str], None] = lambda _: None,
) -> ExportResult:
    """Export a named network as an ELF model.

    Parameters
    ----------
    name : str
        As in ``elf_export.networks.network_names()``.
    layer, descriptors : optional
        The paper's by default; an empty sequence makes a detector without descriptors.
    output : path, optional
        ``elf-NAME-LAYER.onnx`` by default.
    weights : path, optional
        See `elf_export.weights.load.load_weights`.
    force : bool
        Overwrite an existing file.
    detection : DetectionParams, optional
        The settings that the runtime uses where the caller gives none; the network's by default.

    Returns
    -------
    ExportResult

    Raises
    ------
    ExportError
        Unknown network, layer or opset, missing weights, an existing file, or a graph that does not agree
        with torch.autograd; no file is left behind.
    """
    network = get_network(name)
    layer = layer or network.default_layer
    descriptors = list(dict.fromkeys(network.default_descriptors if descriptors is None else descriptors))
    network.check_layers([layer, *descriptors])
    path = check_output(output or f"elf-{name}-{layer}.onnx", force)
    check_opset(opset)
    layers = list(dict.fromkeys([layer, *descriptors]))

    loaded = load_weights(network, layers, weights, offline, log)
    module = network.build(loaded.tensors, layers)
    forward = torch_to_onnx(module, layers, network.preprocessing.channels, opset)
    model = build_saliency(forward, layer, descriptors, NETWORK_INPUT, network.preprocessing)

    from .reference import torch_saliency

    reference = torch_saliency(module, network.preprocessing)
    detection = detection or network.detection
    checks = verify.verify(model, reference, network.preprocessing.channels, detection)
    verify.require(checks)
    log(verify.table(checks))

    fields = receptive_fields(Graph(forward), NETWORK_INPUT)
    arguments = ["elf-export", "--net", name, "--layer", layer, "--desc", ",".join(descriptors) or "none"]
    contract = ModelContract(
        network=name,
        layer=layer,
        stride=fields[layer].stride,
        input=InputSpec(color=network.preprocessing.color, channels=network.preprocessing.channels),
        descriptors=descriptor_specs(model, descriptors, fields),
        detection=detection,
        preprocessing=network.preprocessing.describe(),
        weights=WeightsSpec(loaded.source, loaded.sha256, loaded.licence),
        parity=verify.parity(checks),
        cost=cost_of(model, descriptors),
        versions=versions(opset),
        command=shlex.join(arguments),
    )
    write(model, contract, path)
    return ExportResult(path, contract, checks)
