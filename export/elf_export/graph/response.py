"""Local response normalisation of maps, in terms of convolutions.

    y = x / d^b,   d = k + a/n sum of x^2 over a window of n channels

ONNX Runtime's own operator is slow (16 times a 1x1 convolution of the same map, for 96 channels), and so is pooling
along the channels.  A 1x1 convolution with a band of ones adds up a window too: C multiplications for each value in
place of n, and several times faster all the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import onnx

from .graph import Array, Graph, attributes


@dataclass(frozen=True)
class Response:
    """An LRN node's settings, and the nodes that compute its parts; names begin with `name`."""

    graph: Graph
    x: str
    channels: int
    size: int
    alpha: float
    beta: float
    bias: float

    @classmethod
    def of(cls, graph: Graph, node: onnx.NodeProto) -> Response | None:
        """None where the input is no map (N, C, H, W) of a known number of channels."""
        shape, given = graph.shape(node.input[0]), attributes(node)
        if shape is None or len(shape) != 4 or not isinstance(shape[1], int):
            return None
        alpha, beta, bias = (given.get(key, value) for key, value in (("alpha", 1e-4), ("beta", 0.75), ("bias", 1.0)))
        return cls(graph, node.input[0], shape[1], given["size"], alpha, beta, bias)

    def denominator(self, name: str) -> str:
        """d.  What is squared is scaled first, so that squares stay small: half precision ends at 65504."""
        scale = self._const(math.sqrt(abs(self.alpha) / self.size), f"{name}/scale")
        scaled = self.graph.op("Mul", self.x, scale, name=f"{name}/scaled")
        squares = self.graph.op("Mul", scaled, scaled, name=f"{name}/squares")
        bias = self._const(np.full(self.channels, self.bias), f"{name}/bias")
        return self._sum(squares, np.sign(self.alpha) * self._band(), f"{name}/d", bias)

    def power(self, d: str, name: str) -> str:
        """d^b; by square roots for the usual b = 3/4, which are ten times faster than a power."""
        if self.beta != 0.75:
            return self.graph.op("Pow", d, self._const(self.beta, f"{name}/beta"), name=f"{name}/power")
        root = self.graph.op("Sqrt", d, name=f"{name}/root")
        return self.graph.op("Mul", root, self.graph.op("Sqrt", root, name=f"{name}/fourth_root"), name=f"{name}/power")

    def pull(self, v: str, name: str) -> str:
        """-2 a b / n times the sum of v over the channels whose window holds this one."""
        factor = -2 * self.alpha * self.beta / self.size
        return self._sum(v, factor * self._band().T, f"{name}/pull")

    def _band(self) -> Array:
        """(C, C): 1 where the window of channel i, floor((n - 1) / 2) before it and the rest behind, holds j."""
        i, j = np.indices((self.channels, self.channels))
        before = (self.size - 1) // 2
        inside: Array = (j >= i - before) & (j < i - before + self.size)
        return inside.astype(np.float64)

    def _sum(self, v: str, band: Array, name: str, *bias: str) -> str:
        kernel = self._const(band[:, :, None, None], f"{name}_band")
        return self.graph.op("Conv", v, kernel, *bias, name=name, kernel_shape=[1, 1])

    def _const(self, value: float | Array, name: str) -> str:
        return self.graph.const(value, name, self.graph.dtype(self.x))


def sums_channels(kernel: Array, group: int) -> bool:
    """Whether a Conv of this kernel (O, I/g, k...) adds up channels at one place, all with the same weight."""
    return bool(group == 1 and kernel.shape[2:] == (1, 1) and np.unique(kernel[kernel != 0]).size == 1)
