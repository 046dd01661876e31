"""A contract held against the tensors of its model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .specs import DescriptorSpec, EndToEndSpec, InputSpec


def disagreement(
    spec: InputSpec, saliency: str, descriptors: Sequence[DescriptorSpec], inputs: Sequence[Any], outputs: Sequence[Any]
) -> str | None:
    """What a contract says and its graph does not keep, in words; None where they agree.

    Parameters
    ----------
    saliency : str
        Name of the saliency's output.
    inputs, outputs : sequences of objects with name, type and shape
    """
    wanted: list[tuple[str, str, int, int | None]] = [("saliency_output", saliency, 3, None)]
    wanted += [("descriptors", descriptor.output, 4, descriptor.dim) for descriptor in descriptors]
    by_name = {tensor.name: tensor for tensor in outputs}
    return next(filter(None, [_of_input(spec, inputs), *(_of_output(*output, by_name) for output in wanted)]), None)


IMAGE, GIVEN = "image", ("max_keypoints", "threshold", "mask")
"""The inputs of a graph that gives keypoints itself: the image, and those that have defaults or are required."""


def disagreement_alone(
    form: EndToEndSpec,
    saliency: str,
    descriptors: Sequence[DescriptorSpec],
    inputs: Sequence[Any],
    outputs: Sequence[Any],
) -> str | None:
    """`disagreement` of a graph that gives keypoints itself; `inputs` are those without defaults."""
    taken, wanted = {tensor.name: tensor for tensor in inputs}, {IMAGE, *(GIVEN if form.required else ())}
    if set(taken) != wanted:
        return f"'elf.end_to_end' says inputs {sorted(wanted)}, the graph takes {sorted(taken)}"
    kind, shape = taken[IMAGE].type, list(taken[IMAGE].shape)
    if kind != {"uint8": "tensor(uint8)", "float32": "tensor(float)"}[form.pixels] or len(shape) != 4:
        return f"'elf.end_to_end' says {form.pixels} (N, H, W, C), the graph takes {kind} {shape}"
    by_name, more = {tensor.name: tensor for tensor in outputs}, int(form.batch)
    rows: list[tuple[str, int, int | None]] = [("keypoints", 2 + more, 2), ("scores", 1 + more, None)]
    rows += [("descriptors", 2 + more, descriptor.dim) for descriptor in descriptors[:1]]
    rows += [(saliency, 3, None)] * form.saliency
    found = [_of_output("end_to_end", *row, by_name) for row in rows]
    if form.batch and "counts" not in by_name:
        found.append(f"'elf.end_to_end' says output 'counts', the graph has {sorted(by_name)}")
    return next(filter(None, found), None)


def _of_input(spec: InputSpec, inputs: Sequence[Any]) -> str | None:
    if len(inputs) != 1 or inputs[0].name != spec.name:
        return f"'elf.input' says {spec.name!r}, the graph takes {[tensor.name for tensor in inputs]}"
    kind, shape = inputs[0].type, list(inputs[0].shape)
    if kind != "tensor(float)" or len(shape) != 4 or shape[3] != spec.channels:
        return f"'elf.input' says float32 (N, H, W, {spec.channels}), the graph takes {kind} {shape}"
    stated = {"batch": spec.batch, "height": spec.height, "width": spec.width}
    for (axis, size), dim in zip(stated.items(), shape[:3], strict=True):
        if isinstance(dim, int) and dim != size:
            return f"'elf.input' says {axis} {size or 'free'}, the graph takes {dim} only"
    return None


def _of_output(key: str, name: str, rank: int, dim: int | None, by_name: dict[str, Any]) -> str | None:
    if name not in by_name:
        return f"'elf.{key}' says output {name!r}, the graph has {sorted(by_name)}"
    kind, shape = by_name[name].type, list(by_name[name].shape)
    other_dim = dim is not None and len(shape) == rank and isinstance(shape[-1], int) and shape[-1] != dim
    if kind != "tensor(float)" or len(shape) != rank or other_dim:
        last = f" and last dimension {dim}" if dim else ""
        return f"'elf.{key}' says float32 of rank {rank}{last} for output {name!r}, the graph gives {kind} {shape}"
    return None
