"""Ops of one step, appended to a graph; numbers among their inputs become constants."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from onnx import TensorProto

from elf_export.graph.graph import Graph

FLOAT, DOUBLE, INT64, BOOL = TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.INT64, TensorProto.BOOL
Value = str | np.generic | npt.NDArray[Any]
f32, f64, i64 = np.float32, np.float64, np.int64


class Emit:
    """Adds nodes named ``post/STEP/...``.

    Parameters
    ----------
    graph : Graph
        Changed in place.
    step : str
    """

    def __init__(self, graph: Graph, step: str) -> None:
        self.graph, self._prefix = graph, f"post/{step}"
        self._constants: dict[tuple[str, tuple[int, ...], bytes], str] = {}

    def __call__(self, op: str, *inputs: Value, **attributes: Any) -> str:
        """The name of the first output of a new node."""
        names = [self.value(x) for x in inputs]
        return self.graph.op(op, *names, name=f"{self._prefix}/{op}", **attributes)

    def value(self, x: Value) -> str:
        """A value's name; of a numpy scalar or array, that of a constant."""
        if isinstance(x, str):
            return x
        array = np.asarray(x)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._constants:
            self._constants[key] = self.graph.const(array, f"{self._prefix}/const")
        return self._constants[key]

    def top(self, x: Value, k: Value, sort: bool) -> tuple[str, str]:
        """The k largest of a vector, and their places; sorted, equal ones by ascending place."""
        values = self("TopK", x, self("Reshape", k, np.array([1], i64)), outputs=2, sorted=int(sort))
        return values, str(self.graph.nodes[-1].output[1])

    def cast(self, x: Value, to: int) -> str:
        return self("Cast", x, to=to)

    def size(self, x: str, axis: int) -> str:
        """int64 (): the size of a value along an axis."""
        return self("Gather", self("Shape", x), i64(axis))

    def column(self, x: str) -> str:
        """(N,) -> (N, 1)."""
        return self("Unsqueeze", x, np.array([1], i64))

    def flat(self, x: str) -> str:
        return self("Reshape", x, np.array([-1], i64))

    def count(self, n: Value) -> str:
        """int64 (n,): 0, 1 ... n - 1."""
        return self("Range", i64(0), n, i64(1))

    def both(self, *conditions: str) -> str:
        """The conjunction of conditions."""
        first, *rest = conditions
        for other in rest:
            first = self("And", first, other)
        return first
