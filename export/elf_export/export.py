"""From a named network, or any ONNX model, to a verified .onnx file with its contract."""

from __future__ import annotations

import os
import platform
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import onnx

import elf_runtime
from elf_runtime import DescriptorSpec, DetectionParams, InputSpec, ModelContract, WeightsSpec

from . import verify
from .cost import macs_per_pixel, parameters
from .errors import ExportError
from .forward import DEFAULT_OPSET, NETWORK_INPUT, torch_to_onnx
from .graph import Graph
from .networks import get_network
from .receptive_field import Field, receptive_fields
from .saliency import SALIENCY, build_saliency, descriptor_output, stamp
from .weights.load import load_weights

OPSETS = range(11, 21)


@dataclass
class ExportResult:
    """What an export made."""

    path: Path
    contract: ModelContract
    checks: list[verify.Check] = field(default_factory=list)


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
    if opset not in OPSETS:
        raise ExportError(f"opset {opset} is not supported; choose {OPSETS[0]} to {OPSETS[-1]}")
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


def check_output(output: str | os.PathLike[str], force: bool) -> Path:
    """The path to write to, once it is sure that writing there is wanted and possible."""
    path = Path(output)
    if path.is_dir():
        raise ExportError(f"{path} is a folder; --output names a file")
    if path.exists() and not force:
        raise ExportError(f"{path} exists; --force overwrites it")
    if not path.parent.is_dir():
        raise ExportError(f"{path.parent}: no such folder")
    return path


def descriptor_specs(
    model: onnx.ModelProto, layers: Sequence[str], fields: dict[str, Field]
) -> tuple[DescriptorSpec, ...]:
    """Output, dimension and geometry of each descriptor layer."""
    dims = {value.name: value.type.tensor_type.shape.dim[-1].dim_value for value in model.graph.output}
    return tuple(
        DescriptorSpec(
            descriptor_output(name), name, dims[descriptor_output(name)], fields[name].stride, fields[name].offset
        )
        for name in layers
    )


def cost_of(model: onnx.ModelProto, descriptors: Sequence[str]) -> dict[str, float]:
    """Parameters, and multiply-adds per pixel of the saliency alone and of all outputs together."""
    outputs = [SALIENCY, *(descriptor_output(name) for name in descriptors)]
    return {
        "params": parameters(model),
        "saliency_macs_per_pixel": macs_per_pixel(model, [SALIENCY]),
        "descriptors_macs_per_pixel": macs_per_pixel(model, outputs),
    }


def versions(opset: int) -> dict[str, str]:
    """What made a file: for the contract."""
    import onnxruntime

    found = {
        "elf-onnx": elf_runtime.__version__,
        "opset": str(opset),
        "onnx": onnx.__version__,
        "onnxruntime": onnxruntime.__version__,
        "python": platform.python_version(),
    }
    try:
        import torch
    except ImportError:
        return found
    return found | {"torch": torch.__version__}


def write(model: onnx.ModelProto, contract: ModelContract, path: Path) -> None:
    """Stamp the contract on the model and put the file in place in one step."""
    model.producer_name = "elf-onnx"
    model.producer_version = elf_runtime.__version__
    stamp(model, contract.to_metadata())
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(model.SerializeToString(deterministic=True))
        os.replace(part, path)
    except OSError as error:
        raise ExportError(f"{path}: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)
