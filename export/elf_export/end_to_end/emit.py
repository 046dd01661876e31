"""Ops of one step, appended to a graph; numbers among their inputs become constants."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper

from elf_export.graph.graph import Graph

FLOAT, DOUBLE, INT64, BOOL = TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.INT64, TensorProto.BOOL
Value = str | np.generic | npt.NDArray[Any]
f32, f64, i64 = np.float32, np.float64, np.int64
Made = TypeVar("Made", str, Sequence[str])


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

    def name(self, wanted: str) -> str:
        """A name of this step that no value has."""
        return self.graph.unique(f"{self._prefix}/{wanted}")

    def either(self, condition: str, one: Callable[[], str], other: Callable[[], str]) -> str:
        """An If: what the one or the other function makes, a float map (1, 1, h, w)."""
        branches = {}
        for key, make in (("then_branch", one), ("else_branch", other)):
            found, nodes = self._apart(make)
            branches[key] = helper.make_graph(nodes, key, [], [_map(found)])
        return self("If", condition, **branches)

    def loop(self, most: int, carried: Mapping[str, str], body: Callable[[], Sequence[str]]) -> list[str]:
        """A Loop over float maps (1, 1, h, w): `carried` is the name within -> the first value.

        `body` gives whether to go on, bool (), and the next values; at most so many rounds.  Returns the last values.
        """
        (go_on, *values), nodes = self._apart(body)
        number, going = self.name("round"), self.name("going")
        inputs = [
            helper.make_tensor_value_info(number, INT64, []), helper.make_tensor_value_info(going, BOOL, []),
            *map(_map, carried),
        ]  # fmt: skip
        outputs = [helper.make_tensor_value_info(go_on, BOOL, []), *map(_map, values)]
        inner = helper.make_graph(nodes, "body", inputs, outputs)
        self("Loop", i64(most), np.bool_(True), *carried.values(), outputs=len(carried), body=inner)
        return list(self.graph.nodes[-1].output)

    def for_each(self, count: str, kinds: Sequence[tuple[int, int]], body: Callable[[str], Sequence[str]]) -> list[str]:
        """A Loop over 0 ... count - 1, int64 (); what `body` makes of the number, stacked along a new first axis.

        `kinds` are the element types and ranks of what it makes, of the same shape each time.
        """
        number, going = self.name("number"), self.name("going")

        def made() -> Sequence[str]:
            return [self("Identity", going), *body(number)]

        (go_on, *values), nodes = self._apart(made)
        inputs = [helper.make_tensor_value_info(name, kind, []) for name, kind in ((number, INT64), (going, BOOL))]
        outputs = [helper.make_tensor_value_info(go_on, BOOL, [])]
        for name, (kind, rank) in zip(values, kinds, strict=True):
            outputs.append(helper.make_tensor_value_info(name, kind, [None] * rank))
        inner = helper.make_graph(nodes, "body", inputs, outputs)
        self("Loop", count, np.bool_(True), outputs=len(values), body=inner)
        return list(self.graph.nodes[-1].output)

    def _apart(self, make: Callable[[], Made]) -> tuple[Made, list[onnx.NodeProto]]:
        """What a function makes, and the nodes that it adds, which are taken out of the graph again.

        Constants stay with the graph, where a body reads them.
        """
        start = len(self.graph.nodes)
        found = make()
        added = list(self.graph.nodes[start:])
        copies = [onnx.NodeProto.FromString(node.SerializeToString()) for node in added]
        for node in reversed(added):
            self.graph.remove(node)
        return found, copies

    def both(self, *conditions: str) -> str:
        """The conjunction of conditions."""
        first, *rest = conditions
        for other in rest:
            first = self("And", first, other)
        return first


def _map(name: str) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, FLOAT, [1, 1, None, None])
