"""A convolution as two: its own window to fewer channels, and 1x1 from these to its results."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from elf_export.graph.graph import Graph, attributes

Kernels = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]
"""kernel (r, C, k, k) and bias (r,) of the first, kernel (D, r, 1, 1) and bias (D,) of the second"""


def factor_convs(graph: Graph, factors: Mapping[str, Kernels]) -> Graph:
    """y = W * x + b becomes y = V * (U * x + a) + c.

    requires : `factors` are keyed by the result y of a Conv of one group; it takes what they say for W and b.
    call : on a forward graph.  The adjoint of the two is then as cheap as they are.
    ensures : the first convolution has the strides, pads and dilations; the second makes the value of that name.
    """
    for result, (first, shift, second, offset) in factors.items():
        node = graph.producers()[result]
        given, dtype, name = attributes(node), graph.dtype(node.input[0]), node.name or result
        given.pop("group", None)
        with graph.replace_node(node):
            x = node.input[0]
            weights = [
                graph.const(value, f"{name}/{role}", dtype)
                for role, value in (
                    ("reduce_weight", first),
                    ("reduce_bias", shift),
                    ("expand_weight", second),
                    ("expand_bias", offset),
                )
            ]
            middle = graph.op("Conv", x, *weights[:2], name=f"{name}/reduce", **given)
            graph.op("Conv", middle, *weights[2:], name=f"{name}/expand", outputs=[result], kernel_shape=[1, 1])
    graph.prune()
    return graph
