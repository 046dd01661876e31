"""`--precision`: a verified float32 model in fewer bits, and what that changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import onnx

from elf_export.calibration import CalibrationSet
from elf_export.checks import Check, require
from elf_export.checks.lower_precision import measure
from elf_export.file import stamped
from elf_export.graph.passes import opset_of
from elf_export.request import check_precision
from elf_runtime import ModelContract

from .half import bfloat16_weights, half_precision
from .int8 import quantize


def lower(
    model: onnx.ModelProto,
    masked: onnx.ModelProto,
    contract: ModelContract,
    precision: str,
    images: CalibrationSet,
    log: Callable[[str], None] = lambda _: None,
) -> tuple[onnx.ModelProto, ModelContract, tuple[Check, ...]]:
    """The model and its contract in `precision`, and the check that held it against itself in float32.

    Parameters
    ----------
    model : onnx.ModelProto
        In float32; for int8 best built with ``lowering="int8"``.
    masked : onnx.ModelProto
        The same with its masks in operations of `dialect`.
    precision : str
        int8: convolutions and what lies between them in 8-bit integers (QDQ), fitted to `images`.  fp16: all but the
        preprocessing in float16.  bf16: weights stored in bfloat16, arithmetic in float32.
    images : CalibrationSet
        For int8's ranges, and for the comparison.

    Raises
    ------
    ExportError
        An opset below 13, or a network that does not survive the precision; see `checks.lower_precision`.
    """
    if precision == "fp32":
        return model, contract, ()
    check_precision(precision, opset_of(model))
    if precision == "int8":
        lowered = quantize(masked, images, contract.input, contract.detection.working_scales[0])
    else:
        lowered = half_precision(masked) if precision == "fp16" else bfloat16_weights(model)
    its_contract = replace(contract, precision=precision)
    check = measure(stamped(lowered, its_contract), stamped(model, contract), images)
    require(check, log)
    return lowered, replace(its_contract, parity={**contract.parity, **check.figures()}), (check,)
