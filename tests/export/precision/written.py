"""Nodes in ONNX's textual form on a map of four channels, for the tests of 8 bits."""

from __future__ import annotations

import numpy as np
import onnx

from elf_export.graph.graph import GraphView
from elf_export.precision.int8.candidates import candidates
from elf_export.precision.int8.scheme import Scheme, fitted
from export import small_models as small

from .rounded_networks import with_values

SHAPE = ["N", 4, "H", "W"]
CONV = "Conv<pads = [1, 1, 1, 1]>"
STEP = "elf.Step"
TENSORS = {
    "w": small.weights(16, 4, 3, 3),
    "w2": small.weights(16, 16, 3, 3, seed=1),
    "differences": np.tile(np.array([-1, 1], np.float32).reshape(1, 1, 1, 2), (4, 1, 1, 1)),
    "zero": np.float32(0),
    "top": np.float32(1),
    "two": np.float32(2),
    "tops": np.array([1, 2], np.float32).repeat(8).reshape(16, 1, 1),
    "rows": np.array([0, 16, -1]),
}


def drawn(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).standard_normal(shape).astype(np.float32)


def schemes_of(model: onnx.ModelProto, x: np.ndarray) -> dict[str, Scheme]:
    values = {"x": x} | with_values(model, [name for name in candidates(GraphView(model)) if name != "x"], x)
    return {name: fitted(values[name]) for name in candidates(GraphView(model))}
