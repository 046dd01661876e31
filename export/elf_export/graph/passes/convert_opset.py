"""Bring a model into the range of opsets and IR versions that the adjoint's rules are written for."""

from __future__ import annotations

import re

import onnx
from onnx import helper, version_converter

from elf_export.errors import ExportError
from elf_export.graph.graph import GraphView, attributes, nested_graphs
from elf_runtime.errors import first_line

OPSETS = range(11, 21)
OLD_MODELS = 13  # what a model of an older opset becomes: the rules know it, and most converters reach it
COORDINATES_SINCE = 11  # the opset from which Resize states where its pixels lie
MAX_IR_VERSION = 10  # what onnxruntime of the last years loads


def convert_opset(model: onnx.ModelProto, wanted: int | None = None) -> onnx.ModelProto:
    """A copy of `model` of opset `wanted`; without one, of its own opset, moved into 11 to 20.

    requires : standard ops; onnx's converter knows no others.
    call : before the adjoint, whose rules are written for these opsets.
    ensures : `model` is not changed; an IR version that old runtimes load; pixels of a Resize stay in their places.

    Raises
    ------
    ExportError
        If onnx's converter can't do it; the message says which op it stopped at.
    """
    own, target = opset_of(model), target_opset(model, wanted)
    result = onnx.ModelProto()
    if target == own:
        result.CopyFrom(model)
    else:
        source = onnx.ModelProto()
        source.CopyFrom(model)
        # The converter counts on initializers not to be inputs, which files before IR version 4 don't allow.
        source.ir_version = max(source.ir_version, 4)
        try:
            result = version_converter.convert_version(source, target)
        except Exception as error:  # the converter raises whatever its C++ side threw
            reason = _reason(error, own)
            advice = (
                f"Leave out --opset, which keeps {own}, or export the model again with opset {target}"
                if own in OPSETS
                else f"Export it again with an opset from {OPSETS[0]} to {OPSETS[-1]}"
            )
            raise ExportError(
                f"the model is of opset {own}, and onnx {onnx.__version__} can't convert it to {target}: {reason}.  "
                f"{advice}"
            ) from error
        if own < COORDINATES_SINCE <= target:
            _place_as_before(result)
    result.ir_version = min(max(result.ir_version, 7), MAX_IR_VERSION)
    return result


def _reason(error: Exception, own: int) -> str:
    """Why the converter stopped, without the place in its source where it did."""
    newest = onnx.defs.onnx_opset_version()
    if own > newest:
        return f"it knows opsets up to {newest}"
    text = first_line(error)
    found = re.search(r"No Adapter \w+ Version \$?\d+ for (\w+)|No Previous Version of (\w+) exists", text)
    if found:
        return f"{found[1] or found[2]} means something else there, or does not exist"
    return text.partition("` failed: ")[2] or text


def _place_as_before(model: onnx.ModelProto) -> None:
    """Give every Resize the places of pixels that Upsample, and Resize of opset 10, mean without saying so.

    Output i lies at i / scale; the nearest pixel is the one below it, or, where all scales make the map smaller, the
    one above it, as ONNX Runtime has it.  The converter leaves the defaults of opset 11, which are others.
    """
    constants = GraphView(model)
    for graph in nested_graphs(model.graph):
        for node in graph.node:
            if node.op_type == "Resize" and not node.domain:
                stated = attributes(node)
                places = {"coordinate_transformation_mode": "asymmetric"}
                if stated.get("mode", "nearest") == "nearest":
                    scales = constants.constant(node.input[2]) if len(node.input) > 2 else None
                    smaller = scales is not None and bool((scales <= 1).all() and (scales < 1).any())
                    places["nearest_mode"] = "ceil" if smaller else "floor"
                kept = [attribute for attribute in node.attribute if attribute.name not in places]
                del node.attribute[:]
                node.attribute.extend([*kept, *(helper.make_attribute(*place) for place in places.items())])


def target_opset(model: onnx.ModelProto, wanted: int | None = None) -> int:
    """The opset that `convert_opset` gives the model."""
    own = opset_of(model)
    return wanted or (OLD_MODELS if own < OPSETS[0] else min(own, OPSETS[-1]))


def opset_of(model: onnx.ModelProto) -> int:
    """The opset of standard ONNX that a model is written in.

    Raises
    ------
    ExportError
        If it names none.
    """
    for entry in model.opset_import:
        if entry.domain in ("", "ai.onnx"):
            return int(entry.version)
    raise ExportError("the model names no opset of standard ONNX")


def require_opset(opset: int | None) -> None:
    """Raise ExportError on an opset that the rules are not written for."""
    if opset is not None and opset not in OPSETS:
        raise ExportError(f"opset {opset} is not supported; choose {OPSETS[0]} to {OPSETS[-1]}")
