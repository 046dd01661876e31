"""A graph while it is rewritten: which values are integers by now, and how they were rounded."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import onnx

from elf_export.graph.graph import Graph, GraphView

from .candidates import MOVING
from .scheme import MASK, Scheme


class Quantizer:
    """The graph under construction and what is known of its values.

    Attributes
    ----------
    source : the float graph, which is only read
    graph : a copy of it, whose nodes are replaced one after the other
    schemes : how to round what needs a scheme of its own
    left : results of convolutions that stay in floats
    readers, makers : who reads a value in the float graph, and who makes it
    integers : a value -> its integers
    twins : a value -> the rounded one that its readers get
    rounding : and how it was rounded
    inside : rounded for convolutions alone
    convolved : made by 8-bit convolutions
    masks : of zeros and ones
    origins : the result of an 8-bit convolution -> that of the node that it takes the place of
    shared : products with masks -> the scheme of the sums that they are put together with
    """

    def __init__(self, source: GraphView, schemes: Mapping[str, Scheme], left: Collection[str] = ()) -> None:
        self.source = source
        self.graph = Graph(source.model)
        self.left = left
        self.readers, self.makers = source.consumers(), source.producers()
        self.schemes = {**schemes, **self._schemes_of_parts(schemes)}
        self.outputs = set(source.outputs)
        self.integers: dict[str, str] = {}
        self.twins: dict[str, str] = {}
        self.rounding: dict[str, Scheme] = {}
        self.inside: set[str] = set()
        self.convolved: set[str] = set()
        self.masks: set[str] = set()
        self.origins: dict[str, str] = {}
        self.shared = self._shared_schemes()

    def _shared_schemes(self) -> dict[str, Scheme]:
        """Values that are joined with a sum can be moved as integers only if they are rounded as it is."""
        found: dict[str, Scheme] = {}
        for node in self.source.nodes:
            if node.op_type != "Concat":
                continue
            sources = [self._before_moving(name) for name in node.input]
            sums = {name for name in sources if name in self.schemes and self.makers[name].op_type in ("Add", "Sum")}
            if len(sums) == 1:
                scheme = self.schemes[sums.pop()]
                found.update((name, scheme) for name in sources if name in self.makers)
        return found

    def _schemes_of_parts(self, schemes: Mapping[str, Scheme]) -> dict[str, Scheme]:
        """Convolutions of one value whose results are joined, such as a gradient's phases, share the widest scheme.

        Their integers can then be moved; else they would be rounded again where they are joined.
        """
        found: dict[str, Scheme] = {}
        for node in self.source.nodes:
            parts = self._joined(node.output[0]) if node.op_type == "Concat" else []
            if all(name in schemes and self.makers[name].op_type == "Conv" for name in parts):
                alike = {(self.makers[name].input[0], schemes[name].zero) for name in parts}
                widest = max((schemes[name] for name in parts), key=lambda scheme: scheme.scale, default=None)
                if widest is not None and len(alike) == 1:
                    found.update(dict.fromkeys(parts, widest))
        return found

    def _joined(self, name: str) -> list[str]:
        """What a value is joined of, through what only moves."""
        name = self._before_moving(name)
        maker = self.makers.get(name)
        if maker is None or maker.op_type != "Concat":
            return [name]
        return [part for source in maker.input for part in self._joined(source)]

    def _before_moving(self, name: str) -> str:
        """What the value is made from by ops that only move values."""
        while name in self.makers and self.makers[name].op_type in MOVING - {"Concat"}:
            name = self.makers[name].input[0]
        return name

    def is_rounded(self, name: str) -> bool:
        """Whether all readers of the value get it rounded."""
        return name in self.rounding and name not in self.inside

    def keep(self, node: onnx.NodeProto) -> None:
        """The node as it is, on what there is of its inputs now."""
        # A shape is read off the integers: a value that nobody else reads as floats is never one.
        known = self.integers if node.op_type == "Shape" else self.twins
        inputs = [name if name in self.inside else known.get(name, name) for name in node.input]
        self.graph.rewire(self.graph.add(node), inputs)

    def round(self, name: str, scheme: Scheme) -> None:
        """Round a value that is there in floats; an output of the graph stays as it is."""
        if name in self.outputs:
            return
        q = self.graph.op("QuantizeLinear", name, *self.scale(name, scheme), name=f"{name}/q")
        self.dequantize(name, q, scheme)

    def round_mask(self, name: str) -> None:
        self.round(name, MASK)
        self.masks.add(name)

    def dequantize(self, name: str, q: str, scheme: Scheme) -> None:
        """From here on, `q` are the integers of the value `name`."""
        self.integers[name], self.rounding[name] = q, scheme
        self.twins[name] = self.graph.op("DequantizeLinear", q, *self.scale(name, scheme), name=f"{name}/rounded")

    def scale(self, name: str, scheme: Scheme) -> tuple[str, str]:
        scale = self.graph.const(np.float32(scheme.scale), f"{name}/scale")
        return scale, self.graph.const(np.uint8(scheme.zero), f"{name}/zero")
