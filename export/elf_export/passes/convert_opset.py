"""Bring a model into the range of opsets and IR versions that the adjoint's rules are written for."""

from __future__ import annotations

import onnx
from onnx import version_converter

from elf_export.errors import ExportError
from elf_runtime.errors import first_line

OPSETS = range(11, 21)
OLD_MODELS = 13  # what a model of an older opset becomes: the rules know it, and most converters reach it
MAX_IR_VERSION = 10  # what onnxruntime of the last years loads


def convert_opset(model: onnx.ModelProto, wanted: int | None = None) -> onnx.ModelProto:
    """A copy of `model` of opset `wanted`; without one, of its own opset, moved into 11 to 20.

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
            reason = first_line(error)
            advice = (
                f"Leave out --opset, which keeps {own}, or export the model again with opset {target}"
                if own in OPSETS
                else f"Export it again with an opset from {OPSETS[0]} to {OPSETS[-1]}"
            )
            raise ExportError(
                f"the model is of opset {own}, and onnx {onnx.__version__} can't convert it to {target}: {reason}.  "
                f"{advice}"
            ) from error
    result.ir_version = min(max(result.ir_version, 7), MAX_IR_VERSION)
    return result


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
