"""Seeded stand-ins for trained weights, and a graph's evaluation in float64."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import onnx
from onnx.reference import ReferenceEvaluator
from onnx.reference.op_run import OpRun

from elf_export.checks.float64 import in_double

Tensors = dict[str, npt.NDArray[np.float32]]


def seeded_weights(shapes: Mapping[str, Sequence[int]], seed: int = 0) -> Tensors:
    """Kernels that keep the variance of what they pass, normalisations near the identity."""
    rng = np.random.default_rng(seed)
    tensors: Tensors = {}
    for name, shape in shapes.items():
        role = name.rsplit(".", 1)[1]
        if len(shape) > 1:
            values = rng.standard_normal(shape) * np.sqrt(2 / np.prod(shape[1:]))
        elif role in ("weight", "running_var"):
            values = rng.uniform(0.7, 1.3, shape)
        else:
            values = 0.1 * rng.standard_normal(shape)
        tensors[name] = values.astype(np.float32)
    return tensors


class LRN(OpRun):
    """The operator as specified; onnx's own evaluator fills only as many channels as there are images."""

    op_domain = ""

    def _run(
        self, x: npt.NDArray[np.float64], alpha: float, beta: float, bias: float, size: int
    ) -> tuple[npt.NDArray[np.float64]]:
        squares = np.pad(x * x, ((0, 0), ((size - 1) // 2, size // 2), (0, 0), (0, 0)))
        sums = np.lib.stride_tricks.sliding_window_view(squares, size, axis=1).sum(-1)
        return (x / (bias + alpha / size * sums) ** beta,)


def evaluator64(model: onnx.ModelProto, *stand_ins: type[OpRun]) -> ReferenceEvaluator:
    """An evaluator of `model` in float64; `stand_ins` take the place of operators that onnx's own gets wrong."""
    return ReferenceEvaluator(in_double(model), new_ops=[LRN, *stand_ins])
