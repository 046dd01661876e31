"""Which regions of an 8-bit graph are faster than they were in floats.

A region is what hangs together by integers.  What it saves is arithmetic, and memory: an integer is a quarter of a
float.  What it costs is rounding floats where values enter it and making floats of them where they leave.  Both are
counted in values moved once, a float value's reading and writing being one.  The figures are rough: a region that stays
in integers saves `SURELY` times what it costs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper

from elf_export.graph.graph import Graph, GraphView, attributes
from elf_runtime.model.session import open_session

from .candidates import CLAMPING
from .convolve import BREADTH

MACS = 60  # multiply-adds of a convolution in floats that take as long, less those of one in integers
DEEPER = 4  # copying channels, to have a multiple of four, and convolving the copies: for each value of them all
SURELY = 2
LEAVING = 3  # making floats of integers, in another layout: for each value
WITHIN = frozenset({"Conv", "Mul", "Add", "AveragePool", "Concat"})  # ONNX Runtime fuses these with their roundings
MOVED = frozenset({"MaxPool", "Concat"})  # of integers, as costly in floats as there are values


def losing(model: onnx.ModelProto, origins: Mapping[str, str], pixels: npt.NDArray[np.float32]) -> set[str]:
    """Those of the float graph's convolutions that are in regions which cost more than they save.

    Parameters
    ----------
    model : onnx.ModelProto
        In 8 bits.
    origins : mapping
        Result of a convolution of `model` -> that of the float graph's node which it takes the place of.
    pixels : array
        An image as the model takes it: what costs how much depends on its size.
    """
    return _Regions(model, origins, pixels).losing()


class _Regions:
    def __init__(self, model: onnx.ModelProto, origins: Mapping[str, str], pixels: npt.NDArray[np.float32]) -> None:
        self.graph = GraphView(model)
        self.origins = origins
        self.readers, self.makers = self.graph.consumers(), self.graph.producers()
        self.outputs = set(self.graph.outputs)
        self.parents: dict[str, str] = {}
        self.sizes = _sizes(self.graph, pixels)

    def losing(self) -> set[str]:
        saved: dict[str, float] = {}
        for node in self.graph.nodes:
            if self._is_inside(node):
                for name in node.input:
                    if name in self.sizes and not self._enters(node):
                        self._join(name, node.output[0])
        for node in self.graph.nodes:
            if self._is_inside(node):
                region, gain = self._region(node.output[0]), self._gain(node)
                saved[region] = saved.get(region, 0.0) + (gain if gain > 0 else SURELY * gain)
        # A convolution that gives floats is in no region: it runs in floats, on rounded numbers.
        return {origin for made, origin in self.origins.items() if saved.get(self._region(made), 0.0) <= 0.0}

    def _is_inside(self, node: onnx.NodeProto) -> bool:
        """Whether the node reads or makes integers of the image's; those at the regions' borders too."""
        if node.op_type == "Shape" or not node.output or node.output[0] not in self.sizes:
            return False
        if node.op_type in ("QuantizeLinear", "DequantizeLinear") or self._is_integer(node.output[0]):
            return True
        return self._is_fused(node)

    def _enters(self, node: onnx.NodeProto) -> bool:
        """Whether the node rounds a value that is there in floats."""
        maker = self.makers.get(node.input[0])
        return node.op_type == "QuantizeLinear" and not (maker is not None and self._is_fused(maker))

    def _is_integer(self, name: str) -> bool:
        return self.graph.elem_type(name) == TensorProto.UINT8

    def _is_fused(self, node: onnx.NodeProto) -> bool:
        """Whether ONNX Runtime runs the node, between its roundings, as one on integers."""
        if node.op_type in CLAMPING:
            maker = self.makers.get(node.input[0])
            return maker is not None and maker.op_type == "Conv" and self._is_fused(maker)
        data = [name for name in node.input if name in self.sizes]
        read = [*data, node.input[1]] if node.op_type == "Conv" else data
        rounded = all(name in self.makers and self.makers[name].op_type == "DequantizeLinear" for name in read)
        return node.op_type in WITHIN and bool(data) and rounded and self._is_rounded_after(node.output[0])

    def _is_rounded_after(self, name: str) -> bool:
        readers = self.readers.get(name, [])
        if name in self.outputs or not readers:
            return False
        if len(readers) == 1 and readers[0].op_type in CLAMPING:
            return self._is_rounded_after(readers[0].output[0])
        return all(node.op_type == "QuantizeLinear" for node in readers)

    def _gain(self, node: onnx.NodeProto) -> float:
        """What a node saves, in values; negative if it costs."""
        size = self._count(node.output[0])
        if node.op_type == "QuantizeLinear":
            return -size if self._enters(node) else 0.0
        if node.op_type == "DequantizeLinear":
            readers = self.readers.get(node.output[0], [])
            return 0.0 if all(map(self._is_fused, readers)) else -size * LEAVING
        if node.op_type == "Conv":
            return self._gain_of_conv(node, size)
        if node.op_type == "Gather":
            return -DEEPER * size
        if self._enters_with_rest(node):
            return -size
        clipped = node.op_type == "Clip" and self._is_integer(node.output[0])
        return size if clipped or node.op_type in MOVED or node.op_type in WITHIN else 0.0

    def _gain_of_conv(self, node: onnx.NodeProto, size: float) -> float:
        if attributes(node).get("group", 1) > 1:
            return size
        kernel = self.graph.shape(self.makers[node.input[1]].input[0]) or []
        in_two_steps = self.origins.get(node.output[0], node.output[0]) != node.output[0]
        if in_two_steps and isinstance(kernel[0], int) and kernel[0] > BREADTH:
            # Finely and coarsely: twice the channels that floats have, in as much time.
            return 0.0
        depth = float(np.prod([d for d in kernel[1:] if isinstance(d, int)]))
        source = self.makers.get(node.input[0])
        while source is not None and source.op_type in ("DequantizeLinear", "Gather"):
            source = self.makers.get(source.input[0])
        rests = source is not None and self._enters_with_rest(source)
        return size * depth / MACS / (2 if rests else 1)  # floats have no rests

    def _enters_with_rest(self, node: onnx.NodeProto) -> bool:
        """Whether the node joins an image's integers with what rounding left of it: see `convolve`."""
        makers = [self.makers.get(name) for name in node.input]
        return node.op_type == "Concat" and all(m is not None and self._enters(m) for m in makers)

    def _count(self, name: str) -> float:
        return float(np.prod(self.sizes[name]))

    # -- what hangs together -------------------------------------------------------------------------------------

    def _region(self, name: str) -> str:
        while self.parents.get(name, name) != name:
            name = self.parents[name]
        return name

    def _join(self, a: str, b: str) -> None:
        self.parents[self._region(a)] = self._region(b)


def _sizes(graph: GraphView, pixels: npt.NDArray[np.float32]) -> dict[str, list[int]]:
    """The sizes of what a model computes from one image, as it runs on it."""
    probe = Graph(graph.model)
    inputs = probe.inputs
    made = [name for name in _computed(graph, inputs) if name not in inputs]
    outputs = {probe.op("Shape", name, name=f"{name}/size"): name for name in made}
    probe.set_outputs([helper.make_tensor_value_info(name, TensorProto.INT64, [None]) for name in outputs])
    session, _ = open_session(probe.model.SerializeToString(), optimize=False)
    found = session.run(list(outputs), {inputs[0]: pixels})
    sizes = {outputs[name]: [int(d) for d in dims] for name, dims in zip(outputs, found, strict=True)}
    return sizes | {inputs[0]: list(pixels.shape)}


def _computed(graph: GraphView, inputs: Collection[str]) -> list[str]:
    """What depends on the values of `inputs`, not on their shapes alone."""
    found = dict.fromkeys(inputs)
    for node in graph.nodes:
        if node.op_type != "Shape" and any(name in found for name in node.input):
            found.update(dict.fromkeys(node.output))
    return list(found)
