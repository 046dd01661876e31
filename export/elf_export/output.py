"""What every export ends with: a checked output path, the contract's figures, one file written in one step."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort

import elf_runtime
from elf_runtime import DescriptorSpec, ModelContract
from elf_runtime.contract import ReductionSpec
from elf_runtime.errors import first_line
from elf_runtime.files.write import unwritable, write_atomically
from elf_runtime.model.session import open_session

from .checks import autograd as verify
from .errors import ExportError
from .graph.cost import PROBE, macs_per_pixel, parameters
from .graph.passes import OPSETS
from .graph.receptive_field import Field
from .saliency import SALIENCY, descriptor_output, stamp


@dataclass
class ExportResult:
    """What an export made."""

    path: Path
    contract: ModelContract
    checks: list[verify.Check] = field(default_factory=list)


def check_opset(opset: int) -> None:
    """Raise ExportError on an opset that the rules are not written for."""
    if opset not in OPSETS:
        raise ExportError(f"opset {opset} is not supported; choose {OPSETS[0]} to {OPSETS[-1]}")


def check_output(output: str | os.PathLike[str], force: bool) -> Path:
    """The path to write to, once it is sure that writing there is wanted and possible."""
    path = Path(output)
    try:
        _check_place(path, force)
    except (OSError, ValueError) as error:  # a name that is too long, or that holds a NUL
        raise ExportError(f"{os.fspath(output)!r}: {getattr(error, 'strerror', None) or error}") from error
    return path


def _check_place(path: Path, force: bool) -> None:
    if path.suffix.lower() != ".onnx":
        raise ExportError(f"{path}: a model's name ends in .onnx (elf-info --ort makes an .ort file of one)")
    if path.is_dir():
        raise ExportError(f"{path} is a folder; --output names a file")
    if path.exists() and not force:
        raise ExportError(f"{path} exists; --force overwrites it")
    if reason := unwritable(path.parent):
        raise ExportError(reason)


def first_that_runs(model: onnx.ModelProto, images: Mapping[int, Sequence[int]]) -> int:
    """The first key of `images` on whose size (N, H, W, C) the finished graph runs, and gives no empty map.

    Raises
    ------
    ExportError
        If there is none.
    """
    session, _ = open_session(model.SerializeToString())
    quiet, reason = ort.RunOptions(), "its maps are empty"
    quiet.log_severity_level = 4
    (source,) = session.get_inputs()
    for size, shape in images.items():
        try:
            maps = session.run(None, {source.name: np.zeros(shape, np.float32)}, quiet)
        except Exception as error:  # onnxruntime's own exceptions share no base of theirs
            reason = first_line(error)
            continue
        if all(value.size for value in maps):
            return size
    raise ExportError(f"onnxruntime {ort.__version__} runs the saliency graph at no size that was tried: {reason}")


def descriptor_specs(
    model: onnx.ModelProto,
    layers: Sequence[str],
    fields: Mapping[str, Field],
    reductions: Mapping[str, ReductionSpec] | None = None,
) -> tuple[DescriptorSpec, ...]:
    """Output, dimension, geometry and reduction, if any, of each descriptor layer."""
    dims = {value.name: value.type.tensor_type.shape.dim[-1].dim_value for value in model.graph.output}
    return tuple(
        DescriptorSpec(
            descriptor_output(name),
            name,
            dims[descriptor_output(name)],
            fields[name].stride,
            fields[name].offset,
            (reductions or {}).get(name),
        )
        for name in layers
    )


def cost_of(model: onnx.ModelProto, descriptors: Sequence[str], size: int = PROBE) -> dict[str, float]:
    """Parameters, and multiply-adds per pixel of the saliency alone and of all outputs together, at `size` pixels."""
    outputs = [SALIENCY, *(descriptor_output(name) for name in descriptors)]
    return {
        "params": parameters(model),
        "saliency_macs_per_pixel": macs_per_pixel(model, [SALIENCY], size),
        "descriptors_macs_per_pixel": macs_per_pixel(model, outputs, size),
    }


def versions(opset: int) -> dict[str, str]:
    """What made a file: for the contract."""
    found = {
        "elf-onnx": elf_runtime.__version__,
        "opset": str(opset),
        "onnx": onnx.__version__,
        "onnxruntime": ort.__version__,
        "python": platform.python_version(),
    }
    try:
        import torch
    except ImportError:
        return found
    return found | {"torch": torch.__version__}


def stamped(model: onnx.ModelProto, contract: ModelContract) -> bytes:
    """The file's bytes: the model with the contract on it."""
    model.producer_name = "elf-onnx"
    model.producer_version = elf_runtime.__version__
    stamp(model, contract.to_metadata())
    data: bytes = model.SerializeToString(deterministic=True)
    return data


def write(model: onnx.ModelProto, contract: ModelContract, path: Path) -> None:
    """Put the model with its contract in place in one step."""
    data = stamped(model, contract)
    try:
        write_atomically(path, lambda part: part.write_bytes(data))
    except OSError as error:
        raise ExportError(f"{path}: {error.strerror or error}") from error
