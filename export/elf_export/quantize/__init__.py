"""Lower precision: 8-bit integers fitted to photographs."""

from __future__ import annotations

import onnx

from elf_export.calibration import CalibrationSet
from elf_runtime import InputSpec

from .ranges import schemes_for
from .rewrite import candidates, rewrite

__all__ = ["quantize"]


def quantize(model: onnx.ModelProto, images: CalibrationSet, spec: InputSpec, scale: float) -> onnx.ModelProto:
    """`model` with its convolutions in 8-bit integers; see `rewrite` for how, `ranges` for the arguments."""
    return rewrite(model, schemes_for(model, candidates(model), images, spec, scale))
