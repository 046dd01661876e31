"""Lower precision: 8-bit integers fitted to photographs."""

from __future__ import annotations

import onnx

from elf_export.calibration import CalibrationSet
from elf_export.errors import ExportError
from elf_runtime import InputSpec

from .choice import candidates
from .ranges import schemes_for
from .rewrite import rewrite

__all__ = ["quantize"]


def quantize(model: onnx.ModelProto, images: CalibrationSet, spec: InputSpec, scale: float) -> onnx.ModelProto:
    """`model` with its convolutions in 8-bit integers; see `rewrite` for how, `ranges` for the arguments.

    Raises
    ------
    ExportError
        If no convolution is worth it.
    """
    if not candidates(model):
        raise ExportError("int8: 8-bit integers make no convolution of this network faster; use fp32, fp16 or bf16")
    return rewrite(model, schemes_for(model, candidates(model), images, spec, scale))
