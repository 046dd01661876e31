"""`--precision`: a verified float32 model in fewer bits, and what that changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import onnx

from elf_export.calibration import CalibrationSet
from elf_export.command.options import PRECISIONS
from elf_export.errors import ExportError
from elf_export.graph.passes import opset_of
from elf_export.output import stamped
from elf_runtime import ModelContract

from .half import bfloat16_weights, half_precision
from .int8 import quantize

LEAST_OPSET = 13  # of bfloat16, and of one scale for each channel


def check_precision(precision: str, opset: int) -> None:
    """Raise ExportError on an unknown precision, or an opset too old for it."""
    if precision not in PRECISIONS:
        raise ExportError(f"precision is one of {', '.join(PRECISIONS)}, not {precision!r}")
    if precision != "fp32" and opset < LEAST_OPSET:
        raise ExportError(
            f"the model is of opset {opset}, {precision} needs opset {LEAST_OPSET} or later; choose one with --opset"
        )


def lower(
    model: onnx.ModelProto,
    contract: ModelContract,
    precision: str,
    images: CalibrationSet,
    log: Callable[[str], None] = lambda _: None,
) -> tuple[onnx.ModelProto, ModelContract]:
    """The model and its contract in `precision`, held against themselves in float32.

    Parameters
    ----------
    model : onnx.ModelProto
        In float32; for int8 built with ``channels_last=True``, which is faster there.
    precision : str
        int8: convolutions and what lies between them in 8-bit integers (QDQ), fitted to `images`.  fp16: all but the
        preprocessing in float16.  bf16: weights stored in bfloat16, arithmetic in float32.
    images : CalibrationSet
        For int8's ranges, and for the comparison.

    Raises
    ------
    ExportError
        An opset below 13, or a network that does not survive the precision; see `agreement.measure`.
    """
    if precision == "fp32":
        return model, contract
    from elf_export.checks import agreement  # its scores need the evaluation package

    check_precision(precision, opset_of(model))
    if precision == "int8":
        lowered = quantize(model, images, contract.input, contract.detection.scale)
    else:
        lowered = (half_precision if precision == "fp16" else bfloat16_weights)(model)
    its_contract = replace(contract, precision=precision)
    found = agreement.measure(stamped(lowered, its_contract), stamped(model, contract), images)
    log(agreement.table(precision, found))
    return lowered, replace(its_contract, parity={**contract.parity, **found.figures()})
