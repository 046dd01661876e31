"""A float graph in 8-bit integers that are fitted to photographs.

`candidates` says what may be rounded, `ranges` fits the schemes, `rewrite` makes the graph, and `speedup` says which
regions of it gain.  May import what `precision` may.
"""

from __future__ import annotations

import onnx

from elf_export.calibration import CalibrationSet
from elf_export.errors import ExportError
from elf_export.graph.graph import Graph, GraphView
from elf_export.graph.passes import convolve_averages
from elf_export.lowering import write_steps
from elf_runtime import InputSpec

from .candidates import candidates
from .ranges import schemes_for
from .rewrite import rewrite
from .speedup import losing

__all__ = ["quantize"]


def quantize(model: onnx.ModelProto, images: CalibrationSet, spec: InputSpec, scale: float) -> onnx.ModelProto:
    """`model` with its convolutions in 8-bit integers where `speedup` finds that faster; see `rewrite` for how.

    Parameters
    ----------
    model : onnx.ModelProto
        In float32, opset 13 or later; its masks may be operations of `dialect`.
    images, spec, scale
        As of `ranges.schemes_for`.

    Raises
    ------
    ExportError
        If no convolution gains.
    """
    source = GraphView(convolve_averages(Graph(model)).model)
    names = candidates(source)
    schemes = schemes_for(source, names, images, spec, scale) if names else {}
    left: set[str] = set()
    pixels = next(iter(images.batches(spec, scale)))
    while True:
        lowered, origins = rewrite(source, schemes, left)
        lowered = write_steps(Graph(lowered, copy=False), "int8").model
        if not origins:
            raise ExportError("int8: 8-bit integers make no convolution of this network faster; use fp32, fp16 or bf16")
        lost = losing(lowered, origins, pixels)
        if not lost:
            return lowered
        left |= lost
